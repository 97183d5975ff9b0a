"""`python -m cyclekit` is the command `cyclekit`, for where scripts are not on the path."""

from cyclekit.cli import main

if __name__ == "__main__":
    main()
