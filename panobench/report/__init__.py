"""Reports make one offline HTML file, or tables as LaTeX, CSV, Markdown or JSON, from run folders.

They read files only; neither torch nor Numba is imported here.
"""
