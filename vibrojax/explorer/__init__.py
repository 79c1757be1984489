"""An interactive frequency response."""

from vibrojax.explorer.explorer import Explorer as Explorer
