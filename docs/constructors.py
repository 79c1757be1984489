"""A griffe extension: the reference shows how a module of equinox is constructed.

Equinox makes `__init__` from the annotated fields of a class, as dataclasses do; read statically
the class has none. Results are left out, nobody constructs them: what can be constructed checks its
arguments, or belongs to the model.
"""

import ast

import griffe

NOT_MODULES = ("NamedTuple", "Enum", "Exception", "Error")


class Constructors(griffe.Extension):
    """Give modules an `__init__` with their fields as parameters."""

    def on_class(self, *, cls, loader, **kwargs):
        """Add it where the class has fields and none of its own."""
        bases = [str(base) for base in cls.bases]
        if (
            not bases
            or "__init__" in cls.members
            or not (_is_checked(cls) or cls.path.startswith("vibrojax.model."))
            or any(base.endswith(NOT_MODULES) for base in bases)
        ):
            return
        fields = [_parameter(member) for member in cls.members.values() if _is_field(member)]
        if fields:
            own = griffe.Parameter("self", kind=griffe.ParameterKind.positional_or_keyword)
            init = griffe.Function(
                "__init__", parent=cls, parameters=griffe.Parameters(own, *fields), returns="None"
            )
            cls.set_member("__init__", init)


def _is_checked(cls):
    return any("validated" in str(decorator.value) for decorator in cls.decorators)


def _is_field(member):
    return (
        member.is_attribute
        and member.annotation is not None
        and "property" not in member.labels
        and not str(member.annotation).startswith(("ClassVar", "eqx.AbstractVar", "AbstractVar"))
    )


def _parameter(member):
    return griffe.Parameter(
        member.name,
        annotation=member.annotation,
        kind=griffe.ParameterKind.positional_or_keyword,
        default=_default(member.value),
    )


def _default(value):
    """Return the default that `name: type = value` gives the field, as source; None for none."""
    if value is None:
        return None
    tree = ast.parse(str(value), mode="eval").body
    if not isinstance(tree, ast.Call):
        return str(value)
    given = {word.arg: ast.unparse(word.value) for word in tree.keywords}
    if "default_factory" in given:
        return f"{given['default_factory']}()"
    return given.get("default")
