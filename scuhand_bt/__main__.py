"""The entry point. It imports nothing of the rest before a Ctrl-C is answered in words: that takes half a second."""

import os
import sys

from scuhand_bt.exit_codes import ExitCode


def main() -> None:
    """The command line; the exit code says how it went."""
    for name in ("stdin", "stdout", "stderr"):
        if getattr(sys, name) is None:  # it was closed, and its number must not become the journal's
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_RDWR), "r" if name == "stdin" else "w"))
    try:
        from scuhand_bt import cli

        cli.main()
    except (KeyboardInterrupt, ImportError) as error:
        # A library in C that is interrupted while it is imported says so in its own way.
        if not any(isinstance(one, KeyboardInterrupt) for one in (error, error.__cause__)):
            raise
        print("Interrupted.", file=sys.stderr)
        sys.exit(ExitCode.INTERRUPTED)


if __name__ == "__main__":
    main()
