"""Pages that are one file, made from the templates in `pages/`. Jinja2 is an optional extra."""

from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from scuhand_bt.problems import harmless


def rendered(template: str, **values: Any) -> str:
    """A page; whatever text is put into it is escaped."""
    pages = Environment(
        loader=PackageLoader("scuhand_bt.report", "pages"),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=_readable,
    )
    pages.filters["seconds"] = lambda seconds: f"{seconds:.0f}"
    return pages.get_template(template).render(values)


def _readable(value: Any) -> Any:
    """Text without signs that nobody sees; markup is made only here."""
    return harmless(value, keep="\n") if isinstance(value, str) and not isinstance(value, Markup) else value
