"""The command that runs a lab's tests of its workflows."""

import time
from pathlib import Path
from typing import Annotated

import typer
from rich.text import Text

from scuhand_bt.cli.shared import LabOption, app, out
from scuhand_bt.exit_codes import ExitCode
from scuhand_bt.quantity import counted


@app.command("test")
def run_tests(
    where: Annotated[
        Path | None, typer.Argument(help="A test file or a folder; default: the lab's trees.", show_default=False)
    ] = None,
    update: Annotated[
        bool, typer.Option("--update", help="Write the golden traces instead of comparing them.")
    ] = False,
    lab: LabOption = None,
) -> None:
    """Test workflows on simulated devices, by the `*.test.yaml` files beside them."""
    from scuhand_bt.cli.shared import the_lab
    from scuhand_bt.kit import Coverage, Rehearser, find_test_files, read_test_file, run_case

    loaded = the_lab(lab, where / "x" if where is not None and where.is_dir() else where)
    files = [read_test_file(path, loaded) for path in find_test_files(where or loaded.folder / "trees")]
    rehearser, coverage, failed = Rehearser(loaded), Coverage(loaded), 0
    for file in files:
        out.print(Text(f"{file.path.name}"))
        for case in file.cases:
            began = time.monotonic()
            result = run_case(case, rehearser, update=update)
            if result.ran is not None:
                coverage.add(file.workflow, result.ran)
            said = "FAILED" if result.wrong else "passed"
            out.print(Text(f"  {said}  {case.name} ({time.monotonic() - began:.1f} s)"), soft_wrap=True)
            for wrong in result.wrong:
                out.print(Text(f"    {case.mark}: {wrong}"), soft_wrap=True)
            failed += bool(result.wrong)
        seen, every, missed = coverage.of(file.workflow)
        reached, branches = coverage.branches(file.workflow)
        also = f" and {reached} of {branches} branches" if branches else ""
        out.print(Text(f"  '{file.workflow}': {seen} of {every} skills{also} were reached"))
        for path in missed:
            out.print(Text(f"    never: {path}"), soft_wrap=True)
    count = sum(len(file.cases) for file in files)
    out.print(f"{counted(count, 'test')}, {failed} failed.")
    if failed or not count:
        raise typer.Exit(ExitCode.FLAGGED)
