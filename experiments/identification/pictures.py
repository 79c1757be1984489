"""Pictures of the identification experiment, from the numbers that `run.py` saved."""
from pathlib import Path


def draw_all(folder: Path) -> None:
    pass
