"""One run: its request, its set-up, the frames given to the method, the clock, and the scores."""
