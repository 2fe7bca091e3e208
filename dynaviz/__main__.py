"""The ``dynaviz`` command, and ``python -m dynaviz`` where its script is not on the path."""

import atexit
import ctypes
import gc
import sys

from dynaviz import isolated
from dynaviz.errors import interrupted

# of glibc's mallopt
_ARENA_MAX = -8
_MMAP_THRESHOLD = -3
_TRIM_THRESHOLD = -1


def main() -> None:
    """Run the command line, in a child process if it reads recordings."""
    # All threads allocate in one place: in places of their own, each would keep what it has freed.
    # Arrays of more than 2 MB are given back at once.
    if sys.platform == "linux" and (mallopt := getattr(ctypes.CDLL(None), "mallopt", None)):
        mallopt(_ARENA_MAX, 1)
        mallopt(_MMAP_THRESHOLD, 2 << 20)
        mallopt(_TRIM_THRESHOLD, 16 << 20)
    # or Python would search all modules for garbage before it exits, for half a second
    atexit.register(gc.freeze)
    isolated.run(_main, sys.argv[1:])


def _main() -> None:
    """Import the command line and run it.

    Ctrl-C during the import, the first 0.3 s, ends it without a traceback.
    """
    try:
        from dynaviz.cli import main as run_command
    except (KeyboardInterrupt, ImportError) as error:
        if not interrupted(error):
            raise
        print("dynaviz: interrupted.", file=sys.stderr)
        sys.exit(130)
    run_command()


if __name__ == "__main__":
    main()
