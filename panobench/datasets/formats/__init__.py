"""Layouts of files that datasets come in, one module each."""
