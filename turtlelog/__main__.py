"""`python -m turtlelog`."""

from turtlelog.cli.app import main

if __name__ == "__main__":
    main()
