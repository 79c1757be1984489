"""Switch JAX to float64 when vibrojax is imported, unless the user has decided otherwise."""

import os

import jax

if "JAX_ENABLE_X64" not in os.environ:
    jax.config.update("jax_enable_x64", True)
