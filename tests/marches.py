"""The march of one rig, made ready as one program: operation by operation it takes far longer."""

import equinox as eqx

import vibrojax as vj


@eqx.filter_jit
def prepared(equations, drive, tolerance, steps=None):
    """Return the march of exact contact."""
    return vj.ExactContact(tolerance, steps).prepare(equations, drive)
