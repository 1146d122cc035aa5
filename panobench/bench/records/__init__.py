"""What runs leave: run.json and run folders, and what is made of stored runs."""
