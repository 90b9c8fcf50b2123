"""Makes one page in Markdown of what scripts/bench, scripts/run and scripts/validate wrote.

The page links to the pictures beside the results. Each figure stands with the command, revision and
parameters that made it, and beside the paper's where that has one. The page names every result that
is missing, with the command that makes it.
"""

import sys
from collections.abc import Sequence
from pathlib import Path

from slot_core.command_line import CommandParser, refuse

CANNOT_REPORT = 2  # exit code


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line of `scripts/report`; ends with exit code 2 and one line on a bad input."""
    parser = CommandParser(prog="scripts/report", description=__doc__)
    parser.add_argument(
        "--results",
        type=Path,
        metavar="DIR",
        default="results",
        help="default: results",
    )
    parser.add_argument(
        "--out",
        type=Path,
        metavar="FILE",
        default="results/report.md",
        help="default: results/report.md",
    )
    options = parser.parse_args(arguments)
    from benchmarks.report.page import render  # noqa: PLC0415 - heavy
    from benchmarks.report.results import ReportError  # noqa: PLC0415 - heavy
    from slot_core.recording.origin import revision  # noqa: PLC0415 - heavy

    try:
        if options.out.suffix != ".md":
            raise ReportError(
                f"--out {options.out}: expected a name that ends in .md"
            )
        page = render(options.results, revision(), options.out.parent)
        options.out.parent.mkdir(parents=True, exist_ok=True)
        options.out.write_text(page, encoding="utf-8", errors="replace")
    except (ReportError, OSError) as error:
        refuse(parser.prog, error)
        return CANNOT_REPORT
    print(options.out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
