"""Built-in furnished rooms, ray cast with exact poses and depth."""
