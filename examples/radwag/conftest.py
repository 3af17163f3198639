"""Lets the test find the module beside it, installed or not."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
