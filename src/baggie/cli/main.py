"""`baggie <verb>`: reads the words, has the verb done, shows what came of it; the exit status."""

from __future__ import annotations

import sys
import warnings

from baggie.cli.reading import read
from baggie.errors import BaggieError, BaggieWarning, UsageError, explained
from baggie.registry import named

DONE, FAILED, WRONG_USAGE, INTERRUPTED = 0, 1, 2, 130
_FORMAT_WARNING = warnings.formatwarning


def main(arguments: list[str] | None = None) -> int:
    """Run a verb; the exit status: 0 done, 1 it could not be done, 2 wrong usage (by tyro, too), 130 interrupted."""
    warnings.formatwarning = _format_warning
    return _run(sys.argv[1:] if arguments is None else arguments)


def _format_warning(
    message: Warning | str, category: type[Warning], filename: str, lineno: int, line: str | None = None
) -> str:
    """One line for what users should know; Python's own form for what developers should."""
    if issubclass(category, BaggieWarning):
        return f"warning: {' '.join(str(message).split())}\n"
    return _FORMAT_WARNING(message, category, filename, lineno, line)


def _run(words: list[str]) -> int:
    try:
        asked = read(words)
        if isinstance(asked, str):
            print(asked)
            return DONE
        result = named(asked.verb.does)(asked.options)
        if asked.verb.shows is not None:
            named(asked.verb.shows)(result, asked.json)
    except (BaggieError, OSError) as error:
        return _failed(error)
    except ImportError as error:
        if (missing := explained(error)) is None:
            raise
        return _failed(missing)
    except KeyboardInterrupt as interruption:
        print(str(interruption) or "interrupted; the same command again goes on", file=sys.stderr)
        return INTERRUPTED
    return DONE


def _failed(error: Exception) -> int:
    """Say why in one line; the exit status."""
    print("error:", " ".join(str(error).split()), file=sys.stderr)
    return WRONG_USAGE if isinstance(error, UsageError) else FAILED


if __name__ == "__main__":
    sys.exit(main())
