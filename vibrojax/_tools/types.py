"""Types shared by annotations."""

import jax
import numpy as np

AnyArray = jax.Array | np.ndarray
"""For what runs both on the host with numpy and inside of JAX."""
