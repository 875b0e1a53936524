"""Names that a file may carry, and what they must never do: run, compute, reach a folder, move a cursor."""

from html.parser import HTMLParser

VISIBLE = (
    "<script>document.title='owned'</script>",
    "{{ 7 * 7 }}{% for x in y %}${7*7}<% 7 %>",
    "../../../reached",
    "=cmd|'/c calc'!A1",
    "+1+1",
    "\"><img src=x onerror=document.title='owned'>'",
    "</script></details><!-- --> ]]> <![CDATA[ --->",
    "$\\frac{1$ 落",
    "[red]x[/red] `x` **x** \\n",
    "javascript:document.title='owned'",
)
# Characters that nobody sees, and lengths that nobody reads.
HIDDEN = ("line\nbreak", "\x1b[31mred\x1b[0m", "tu\u202enrut", "nul\x00l", "car\rriage", "x" * 10_000)


class Page(HTMLParser):
    """Elements and attributes of a page as a browser sees them."""

    def __init__(self, text):
        super().__init__()
        self.scripts, self.handlers, self.policies, self.links = 0, [], [], set()
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.scripts += tag == "script"
        self.handlers += [key for key, _ in attributes if key.startswith("on")]
        addresses = {value for key, value in attributes if key in ("src", "href", "action")}
        self.links |= {address for address in addresses if not address.startswith(("data:image/", "#"))}
        if tag == "meta" and dict(attributes).get("http-equiv") == "Content-Security-Policy":
            self.policies.append(dict(attributes)["content"])
