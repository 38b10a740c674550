"""`python -m diffshade` is the command `diffshade`."""

from .cli import main

main()
