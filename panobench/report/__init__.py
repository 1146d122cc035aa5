"""Reports: run folders in, one offline HTML file or the same tables as LaTeX, CSV, Markdown or JSON out.

Reads files only; neither torch nor numba is imported here.
"""
