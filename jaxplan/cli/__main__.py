"""``python -m jaxplan.cli``."""

from jaxplan.cli import main

if __name__ == "__main__":
    main()
