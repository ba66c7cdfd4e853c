"""``python -m fiohost``: the same as the command ``fiohost``."""

from fiohost.cli.main import main

if __name__ == "__main__":
    main()
