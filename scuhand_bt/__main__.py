"""`python -m scuhand_bt` is the command line."""

from scuhand_bt.cli import main

main()
