"""XML documents that other simulators read, filled in from the templates in this folder."""

from jinja2 import Environment, PackageLoader, StrictUndefined

from sysid.errors import printable


def document(template: str, **content: object) -> bytes:
    """Return the file of a template; numbers read back to equal values, tuples stand between spaces."""
    templates = Environment(
        loader=PackageLoader("sysid.export"), autoescape=True, undefined=StrictUndefined,
        finalize=_written, keep_trailing_newline=True,
    )  # fmt: skip
    return templates.get_template(template).render(content).encode("utf-8")


def _written(value: object) -> object:
    if isinstance(value, tuple):
        return " ".join(map(str, value))
    # XML has no control characters.
    return printable(value) if isinstance(value, str) and not hasattr(value, "__html__") else value
