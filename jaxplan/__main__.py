"""``python -m jaxplan``: the command line."""

from jaxplan.cli import main

if __name__ == "__main__":
    main()
