"""What every public result shows of itself."""

from matplotlib.figure import Figure


def readable(text, name):
    """A few lines with the name, none of JAX's."""
    assert name in text
    assert len(text) < 1500
    assert "f64[" not in text
    assert " at 0x" not in text
    return text


def check_result(result):
    """A text, a picture, and a dataset whose numbers have units and long names."""
    readable(repr(result), type(result).__name__)
    assert isinstance(result.plot(), Figure)
    dataset = result.to_xarray()
    for name, variable in dataset.variables.items():
        if variable.dtype.kind in "fciub" and "lane" not in str(name):
            assert variable.attrs.get("long_name"), f"{name} has no long name"
            assert "units" in variable.attrs, f"{name} has no unit"
