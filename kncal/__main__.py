"""``python -m kncal``."""

from kncal.cli import main

main()
