"""Arguments of a call in one table: those that are settings go into their object."""

import dataclasses


def with_settings(kind, arguments):
    """Return the arguments of a study, with the fields of its settings in `settings`."""
    fields = {field.name for field in dataclasses.fields(kind)}
    own = {name: value for name, value in arguments.items() if name in fields}
    others = {name: value for name, value in arguments.items() if name not in fields}
    return others | ({"settings": kind(**own)} if own else {})
