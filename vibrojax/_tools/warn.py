"""Warnings that name the line of the user's, however many calls of vibrojax lie between."""

import sys
import warnings
from pathlib import Path

_OWN = str(Path(__file__).parents[1])


def warn(sentence: str) -> None:
    """Warn of something at the line outside vibrojax that called it."""
    level, frame = 1, sys._getframe()
    while frame is not None and frame.f_code.co_filename.startswith(_OWN):
        level, frame = level + 1, frame.f_back
    warnings.warn(sentence, stacklevel=level)
