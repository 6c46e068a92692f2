"""The site of `make docs`: README, CONTRIBUTING, CHANGELOG, the pages of docs/ and the API.

The folder of sources is the root of the repository, so that links between pages are the same here
and in a checkout.  A warning is an error; nothing is downloaded.
"""

from __future__ import annotations

import pkgutil
import re
import types
from pathlib import Path

import latex2mathml.converter
import scipy.stats  # noqa: F401  (before torch is mocked, of whose classes it asks)
from docutils import nodes
from docutils.nodes import SkipNode, Text, raw
from sphinx.addnodes import desc_annotation

import spoofgym

ROOT = Path(__file__).resolve().parents[1]
PAGES = {"README.md", "CONTRIBUTING.md", "CHANGELOG.md", "SECURITY.md", "docs"}
CARDS = "\n```{container} cards\n%s\n```\n\n## Install\n"
"""On the first page, before its first heading: the tutorials."""
TREE = "\n```{toctree}\n:hidden:\n:glob:\n:caption: %s\n%s\n```\n"
MORE = {
    "Tutorials": ["docs/README"],
    "Start": ["docs/environments/*"],
    "The library": ["CONTRIBUTING", "SECURITY", "CHANGELOG"],
}
"""Pages that docs/README.md does not list, by its headings."""

UNITS = re.compile(r"(?<=\d) (?=(?:%|[km]?m|m?s|k?Hz|min|h|[kM]B|GB|m/s|m/s2|dB)(?![\w/]))")

project, author, version = "spoofgym", "The spoofgym developers", spoofgym.__version__
extensions = ["myst_nb", "numpydoc", "sphinx.ext.autodoc", "sphinx.ext.viewcode"]
root_doc = "README"
exclude_patterns = [each.name for each in ROOT.iterdir() if each.name not in PAGES]
html_theme = "furo"
html_title = f"spoofgym {version}"
html_copy_source = False
html_show_copyright = False
html_show_search_summary = False  # it fetches pages, which a browser forbids to a site of files
html_css_files = ["site.css"]
html_static_path = ["static"]
pygments_dark_style = "a11y-dark"

myst_heading_anchors = 3
nb_execution_mode = "off"  # tutorials hold what they printed
nb_merge_streams = True
myst_enable_extensions = ["dollarmath"]
html_math_renderer = "mathml"

default_role = "py:obj"
nitpicky = True
python_use_unqualified_type_names = True
toc_object_entries_show_parents = "hide"
autodoc_mock_imports = ["stable_baselines3", "torch"]
autodoc_default_options = {"members": True, "member-order": "bysource"}
autodoc_typehints_format = "short"
numpydoc_show_class_members = False


def add_contents(app, docname, source):
    """Let the first page show the tutorials as cards, and list all pages, by the headings and the
    rows of docs/README.md."""
    if docname == root_doc:
        for part in (ROOT / "docs/README.md").read_text().split("\n## ")[1:]:
            caption = part.splitlines()[0]
            if caption == "Tutorials":
                rows = re.findall(r"^\| \[(.*?)\]\((.*?)\) \| (.*) \|$", part, re.M)
                cards = [
                    f"- [**{name[0].upper()}{name[1:]}**](docs/{page})\n\n  {what}"
                    for name, page, what in rows
                ]
                before, after = source[0].split("\n## Install\n")
                source[0] = before + CARDS % "\n\n".join(cards) + after
            pages = [f"docs/{x}" for x in re.findall(r"^\| \[.*?\]\((.*?)\.\w+\)", part, re.M)]
            source[0] += TREE % (caption, "\n".join(pages + MORE.get(caption, [])))


def break_specs(app, doctree, docname):
    """Let a long word of a table, such as a detector with its settings, break at its marks."""
    for entry in doctree.findall(nodes.entry):
        for text in list(entry.findall(Text)):
            if max(map(len, text.split()), default=0) > 16:
                parts = re.split(r"(?<=[(,=/])", text)
                pieces = [x for y in parts for x in re.split("(?<=_)" * (len(y) > 16) or "$^", y)]
                marks = [
                    x for each in pieces for x in (raw("", "<wbr>", format="html"), Text(each))
                ]
                text.parent.replace(text, marks[1:])


def hold_together(app, doctree, docname):
    """Keep a number with its unit, and a short name such as ``--detector``, on one line."""
    for text in list(doctree.findall(Text)):
        if isinstance(text.parent, nodes.literal):
            text.parent["classes"] += ["short"] * (len(text) <= 20 and " " not in text)
        elif isinstance(text.parent, nodes.TextElement) and not text.parent.get("xml:space"):
            held = UNITS.sub("\u00a0", text)
            if held != text:
                text.parent.replace(text, Text(held))


def silence(app, env, node, contnode):
    """Show a name that is not on the site as it is, unless it names what spoofgym does not have."""
    target = node.get("reftarget", "")
    if node.get("refdomain") != "py" or (target.startswith("spoofgym.") and not exists(target)):
        return None
    return contnode


def first_paragraph(app, what, name, obj, options, lines):
    """Of a module's docstring: the rest, a map or a form, is for readers of the source."""
    if what == "module" and "" in lines:
        del lines[lines.index("") :]


def written_defaults(app, what, name, obj, options, signature, returns):
    """Write a default that is made as what parses."""
    return (signature.replace("<factory>", "..."), returns) if signature else None


def skip_member(app, what, name, obj, skip, options):
    """Leave out pydantic's own, and types such as ``tuple[str, ...]``, taken for calls."""
    return True if name == "model_config" or isinstance(obj, types.GenericAlias) else None


def shorten(app, domain, objtype, content):
    """Leave out long values, such as those of registries."""
    for note in list(content.parent.findall(desc_annotation)):
        if objtype == "data" and note.astext().startswith(" = ") and len(note.astext()) > 60:
            note.parent.remove(note)


def write_formula(self, node):
    """A formula as MathML, which browsers draw without a script or a font from elsewhere."""
    display = "block" if node.tagname == "math_block" else "inline"
    self.body.append(latex2mathml.converter.convert(node.astext(), display=display))
    raise SkipNode


def mend_backlinks(app, pagename, templatename, context, doctree):
    """Let [docs] in a source lead to the name as its page has it.

    viewcode writes all names of a file as of one module, also those that a page takes from another.
    """
    listed = {name: each.docname for name, each in app.env.domaindata["py"]["objects"].items()}

    def mend(found):
        link, folder, page, name = found.group(0, 1, 2, 3)
        same = [each for each in listed if listed[each] == page]
        ends = [name.split(".", k)[-1] for k in range(1, name.count(".") + 1)]
        names = [each for end in ends for each in same if each.endswith("." + end)]
        return link if name in same or not names else f'href="{folder}{page}.html#{names[0]}"'

    if pagename.startswith("_modules/"):
        context["body"] = re.sub(
            r'href="((?:\.\./)*)([\w/]+)\.html#([\w.]+)"', mend, context["body"]
        )


def exists(name):
    """Whether a dotted name is a module, or something in one."""
    try:
        pkgutil.resolve_name(name)
    except (ImportError, AttributeError):
        return False
    return True


def setup(app):
    """Called by Sphinx."""
    app.add_html_math_renderer("mathml", (write_formula, None), (write_formula, None))
    app.connect("source-read", add_contents)
    app.connect("doctree-resolved", hold_together)
    app.connect("doctree-resolved", break_specs)
    app.connect("autodoc-process-docstring", first_paragraph)
    app.connect("autodoc-process-signature", written_defaults)
    app.connect("autodoc-skip-member", skip_member)
    app.connect("missing-reference", silence)
    app.connect("object-description-transform", shorten)
    app.connect("html-page-context", mend_backlinks)
