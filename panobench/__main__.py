"""`python -m panobench`: the command line."""

from panobench.cli.main import main

if __name__ == "__main__":
    main()
