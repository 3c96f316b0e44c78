"""`python -m armflex` is the command line."""

from armflex.cli.main import main

if __name__ == "__main__":
    main()
