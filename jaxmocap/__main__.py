"""`python -m jaxmocap`."""

from jaxmocap.cli import main

if __name__ == "__main__":
    main()
