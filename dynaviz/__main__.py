"""``python -m dynaviz``: the command line, where its script is not on the path."""

from dynaviz.cli import main

if __name__ == "__main__":
    main()
