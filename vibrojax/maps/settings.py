"""What a map is known by: settings, rigs and functions, as its store keeps them."""

import json
import os
from collections.abc import Callable
from importlib.metadata import version
from typing import Any

import equinox as eqx
import jax

from vibrojax._tools.described import recipe
from vibrojax.maps.basin_map import BasinFractions
from vibrojax.maps.fingerprints import identity_of, source_of, value_digest
from vibrojax.maps.rig_maker import RigMaker
from vibrojax.maps.store_files import digest
from vibrojax.maps.work import MapSpec
from vibrojax.model.systems import AbstractSystem

FORMAT = 3
"""Changes when older stores cannot be continued any more."""
CHANGING = "changes while the map is computed"
"""Stands for what a measure reads that is no setting, such as a counter."""
LONGEST = 400
"""Characters of a difference that are shown."""
RIGS = ("first_rig", "last_rig")
"""Settings that may differ where the rigs of some chunks are others than they were."""


def settings_of(spec: MapSpec, maker: RigMaker) -> dict[str, Any]:
    """All that decides the values of a map, as JSON: stores of other settings are refused."""
    dimensions = spec.arguments.dimensions
    ends = ((0,) * len(dimensions), tuple(d.size - 1 for d in dimensions))
    own = [identity_of(m.function) for m in spec.measures]
    return {
        "format": FORMAT,
        "vibrojax_version": version("vibrojax"),
        "jax_version": version("jax"),
        "float64": bool(jax.config.read("jax_enable_x64")),
        "axes": {d.name: {n: v.tolist() for n, v in d.values.items()} for d in dimensions},
        "axis_order": [d.name for d in dimensions],
        "fixed": {n: _fixed(v) for n, v in spec.arguments.fixed.items()},
        "frequency": {"axis": spec.grid.axis, "values": spec.grid.values.tolist()},
        "single_frequency": spec.grid.single,
        "response": spec.response.recipe,
        "measures": {
            m.name: None if m.own else {"source": one.source, "reads": one.reads}
            for m, one in zip(spec.measures, own, strict=True)
        },
        "keep_curves": spec.keep_curves,
        "gradients": list(spec.gradients),
    } | {name: _fixed(maker.sample(at)) for name, at in zip(RIGS, ends, strict=True)}


def _fixed(value: Any) -> str:
    """A fixed argument or a system in words, and what stands for every digit of it and its code."""
    # Neither repr nor recipe, which are for people and may change: a store is known by this text.
    if isinstance(value, eqx.Module):
        return f"{eqx.tree_pformat(value)} {value_digest(value)}"
    if callable(value):
        return f"{getattr(value, '__name__', 'function')} {value_digest(value)}"
    return repr(value)


def identity_of_chunks(settings: dict[str, Any]) -> str:
    """Return what the records of chunks know the settings by: those that never change."""
    others = (*RIGS, "measures")
    return digest(json.dumps({n: v for n, v in settings.items() if n not in others}))


def unread_of(spec: MapSpec) -> list[str]:
    """Return what functions of the user read and has no fingerprint, in words."""
    own: dict[str, Callable[..., Any]] = {m.name: m.function for m in spec.measures if not m.own}
    if isinstance(spec.response, BasinFractions):
        own["start"] = spec.response.starts.start
    return [f"{name}: {what}" for name, f in own.items() for what in identity_of(f).unknown]


def with_changing(settings: dict[str, Any], known: dict[str, Any]) -> dict[str, Any]:
    """Take over from other settings what of the measures is known to change."""
    if known.get("format") != FORMAT:
        return settings
    for name, own in settings["measures"].items():
        other = known["measures"].get(name)
        if own and other:
            changing = {n: t for n, t in other["reads"].items() if t == CHANGING}
            settings = _reading(settings, name, own["reads"] | changing)
    return settings


def after_computing(spec: MapSpec, settings: dict[str, Any]) -> dict[str, Any]:
    """Return the settings with what its own computing changes, such as a counter, left out."""
    for m in spec.measures:
        if not m.own:
            now, known = identity_of(m.function).reads, settings["measures"][m.name]["reads"]
            kept = {n: t if now.get(n) == t else CHANGING for n, t in known.items()}
            settings = _reading(settings, m.name, kept)
    return settings


def _reading(settings: dict[str, Any], name: str, reads: dict[str, str]) -> dict[str, Any]:
    """Return settings in which a measure reads something else."""
    measures = settings["measures"]
    return settings | {"measures": measures | {name: measures[name] | {"reads": reads}}}


def attributes_of(
    spec: MapSpec, sample: AbstractSystem, settings: dict[str, Any]
) -> dict[str, Any]:
    """What the dataset says of itself: enough to make it again."""
    dims = {*spec.template.outer, *(d for v in spec.template.variables.values() for d in v.inner)}
    others = [name for name in spec.template.coordinates if name not in dims]
    return {
        "title": "vibrojax parameter map",
        "rig": recipe(sample),
        "rig_source": source_of(spec.make),
        "call": _call(spec),
        "vibrojax_version": settings["vibrojax_version"],
        "jax_version": settings["jax_version"],
        "block": json.dumps(spec.chunks.block),
        **({"coordinates": " ".join(others)} if others else {}),
        "vibrojax_map": json.dumps(settings),
    }


def _call(spec: MapSpec) -> str:
    """The call that makes the map, as Python."""
    name = getattr(spec.make, "__name__", "make_system")
    values = spec.grid.values.tolist()
    parts = [name if name.isidentifier() else "make_system"]
    for d in spec.arguments.dimensions:
        inside = ", ".join(f"{n}={v.tolist()!r}" for n, v in d.values.items())
        parts.append(f"{d.name}=vj.zipped({inside})" if len(d.values) > 1 else inside)
    parts += [f"{n}={recipe(v)}" for n, v in spec.arguments.fixed.items()]
    names = ", ".join(repr(m.name) if m.own else m.name for m in spec.measures)
    parts += [
        f"{spec.grid.axis}={values[0] if spec.grid.single else values!r}",
        f"response=vj.{spec.response.recipe}",
        f"measures=[{names}]",
        f"keep_curves={spec.keep_curves}",
        *([f"gradients={list(spec.gradients)!r}"] if spec.gradients else []),
    ]
    return f"vj.parameter_map({', '.join(parts)})"


def settings_in(path: Any, found: dict[str, Any]) -> tuple[dict[str, Any], tuple[int, ...]]:
    """Return the settings of a store, and the lengths of its blocks.

    Raises `ValueError` where they cannot be read.
    """
    try:
        made, block = dict(json.loads(found["vibrojax_map"])), tuple(json.loads(found["block"]))
    except (ValueError, TypeError, KeyError, RecursionError):
        raise ValueError(
            f"store: {str(path)!r} is damaged: neither its zarr.json nor the copy of it can be "
            "read. Give another path."
        ) from None
    return made, block


def check_same(path: Any, made: dict[str, Any], settings: dict[str, Any]) -> None:
    """Refuse, with a `ValueError` that names the difference, a store made with other settings.

    Rigs are not compared.
    """
    if made.get("format") != settings["format"]:
        raise ValueError(
            f"store: {str(path)!r} has format {made.get('format')} (vibrojax "
            f"{made.get('vibrojax_version')}), this version writes format {settings['format']}. "
            "Give another path, or read it with xarray.open_zarr."
        )
    for name in settings:
        if name not in RIGS:
            check_one(path, name, made, settings)


def check_one(path: Any, name: str, made: dict[str, Any], settings: dict[str, Any]) -> None:
    """Refuse a store in which one of the settings differs."""
    value = settings[name]
    if made.get(name) != value:
        raise ValueError(
            f"store: {str(path)!r} was made with other settings. {name.replace('_', ' ')}: "
            f"{_difference(made.get(name), value)}. Give another path, or the same settings."
        )


def _difference(made: Any, asked: Any) -> str:
    """Say in what two settings differ, in few words."""
    if isinstance(made, dict) and isinstance(asked, dict):
        for key in [*made, *(k for k in asked if k not in made)]:
            if made.get(key) != asked.get(key):
                inside = _difference(made.get(key), asked.get(key))
                return inside if inside.startswith(f"{key}: ") else f"{key}: {inside}"
        return "the order of its parts"
    if isinstance(made, list) and isinstance(asked, list) and len(made) != len(asked):
        return f"{len(made)} values there, {len(asked)} now"
    if isinstance(made, list) and isinstance(asked, list):
        k = next(i for i, (a, b) in enumerate(zip(made, asked, strict=True)) if a != b)
        return f"value {k + 1} is {made[k]!r} there, {asked[k]!r} now"
    texts = ["nothing" if value is None else repr(value) for value in (made, asked)]
    if max(map(len, texts)) > LONGEST:  # where they part
        same = len(os.path.commonprefix(texts))  # noqa: RUF071 (of letters)
        first = max(0, same - LONGEST // 4)
        ends = ["..." * (len(text) > first + LONGEST) for text in texts]
        parts = (text[first : first + LONGEST] for text in texts)
        texts = [f"{'...' * (first > 0)}{p}{e}" for p, e in zip(parts, ends, strict=True)]
    return f"{texts[0]} there, {texts[1]} now"
