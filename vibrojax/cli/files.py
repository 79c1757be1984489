"""What the commands share: reading the rig, writing files, watching the clock."""

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from vibrojax.model.impacting_beam import ImpactingBeam

PICTURES = (".png", ".svg", ".pdf")


def read(rig: Path | None) -> tuple["ImpactingBeam", dict[str, Any]]:
    """Return the rig of a file, else the default rig, and the settings of its sweep."""
    if rig is None:
        from vibrojax.model.examples import default_rig

        return default_rig(), {}
    from vibrojax.io.rig_file import read_rig

    return read_rig(rig)


def check_driven(rig: Path | None, system: "ImpactingBeam", command: str) -> None:
    """Refuse a rig that nothing drives, with a `ValueError`."""
    from vibrojax.model.drives import NoDrive

    if isinstance(system.drive, NoDrive):
        raise ValueError(f"Rig file {str(rig)!r}: a {command} needs the table [drive].")


def target(option: str, path: Path | None, suffixes: tuple[str, ...]) -> Path | None:
    """Refuse a file that could not be written, before anything is computed."""
    if path is None or str(path).lower() == "none":
        return None
    if path.suffix.lower() not in suffixes:
        allowed = " or ".join(
            [", ".join(suffixes[:-1]), suffixes[-1]] if suffixes[1:] else suffixes
        )
        raise ValueError(f"{option} must end in {allowed}, got {str(path)!r}.")
    if path.is_dir():
        raise ValueError(f"{option}: {str(path)!r} is a folder.")
    if not path.parent.is_dir():
        raise ValueError(f"{option}: the folder {str(path.parent)!r} does not exist.")
    if not os.access(path.parent, os.W_OK) or (path.exists() and not os.access(path, os.W_OK)):
        raise ValueError(f"{option}: {str(path)!r} cannot be written, for lack of permission.")
    return path


def watch_compilation() -> list[float]:
    """Return a list that fills with the seconds of every compilation."""
    import jax.monitoring

    seconds: list[float] = []

    def listen(event: str, duration_secs: float, **kwargs: str | int) -> None:
        if event.endswith(("backend_compile_duration", "jaxpr_to_mlir_module_duration")):
            seconds.append(duration_secs)

    jax.monitoring.register_event_duration_secs_listener(listen)
    return seconds
