"""A lab's own tests: workflows by `*.test.yaml` files, skills and workflows in Python by a pytest plugin."""

from typing import TYPE_CHECKING

from scuhand_bt.fronts import front

if TYPE_CHECKING:
    from scuhand_bt.kit.case_files import find_test_files, read_test_file
    from scuhand_bt.kit.cases import Coverage, run_case
    from scuhand_bt.kit.new_device import write_device
    from scuhand_bt.kit.rehearsed import Rehearser
    from scuhand_bt.kit.schemas import KINDS_OF_FILES, vscode_settings, write_schemas, written
else:
    __getattr__, __dir__ = front(
        __name__,
        {
            "kit.case_files": "find_test_files read_test_file",
            "kit.cases": "Coverage run_case",
            "kit.new_device": "write_device",
            "kit.rehearsed": "Rehearser",
            "kit.schemas": "KINDS_OF_FILES vscode_settings write_schemas written",
        },
    )

__all__ = [
    "KINDS_OF_FILES",
    "Coverage",
    "Rehearser",
    "find_test_files",
    "read_test_file",
    "run_case",
    "vscode_settings",
    "write_device",
    "write_schemas",
    "written",
]
