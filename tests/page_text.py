"""What a page of HTML says, for tests."""

from html.parser import HTMLParser


class Tables(HTMLParser):
    """A page's tables by the label of their region, what it would fetch, and its elements."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.found: dict[str, list[list[str]]] = {}
        self.fetched: list[str] = []
        self.elements: list[str] = []
        self.text = ""
        self._label = ""
        self._cell: list[str] | None = None
        self.feed(text)

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.elements.append(tag)
        given = dict(attributes)
        self.fetched += [value or "" for name, value in attributes if name in ("src", "href", "data", "xlink:href")]
        if given.get("role") == "region":
            self._label = given["aria-label"] or ""
            self.found.setdefault(self._label, [])
        elif tag == "tr":
            self.found[self._label].append([])
        elif tag in ("td", "th"):
            self._cell = []

    def handle_endtag(self, tag: str) -> None:
        if tag in ("td", "th") and self._cell is not None:
            self.found[self._label][-1].append("".join(self._cell).strip())
            self._cell = None

    def handle_data(self, data: str) -> None:
        self.text += data
        if self._cell is not None:
            self._cell.append(data)
