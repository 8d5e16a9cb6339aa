"""``python -m timesim``: the same as the command ``timesim``."""

from timesim.cli import main

if __name__ == "__main__":
    main()
