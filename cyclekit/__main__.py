"""`python -m cyclekit` runs the command `cyclekit`, for systems without scripts on the path."""

from cyclekit.cli import main

if __name__ == "__main__":
    main()
