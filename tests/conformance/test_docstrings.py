"""Docstrings of the public API agree with fields and arguments, and what they cite is known.

numpydoc's own validation takes no dataclass field for a parameter, hence these tests.  Public are
the names in an `__all__` and the terms; whatever else has sections must have them right.
"""

import dataclasses
import inspect
import re
import tomllib

from numpydoc.docscrape import ClassDoc, FunctionDoc

from spoofgym.detectors import DETECTORS
from spoofgym.envs import TERMS

from . import sources

CONFIG = tomllib.loads((sources.CHECKOUT / "pyproject.toml").read_text())["tool"]
LEFT_OUT = re.compile("|".join(CONFIG["numpydoc_validation"]["exclude"]))


def exported():
    """Classes and functions of every `__all__`, and the terms."""
    named = {
        getattr(module, name)
        for module in sources.modules()
        for name in vars(module).get("__all__", ())
        if inspect.isroutine(getattr(module, name)) or inspect.isclass(getattr(module, name))
    }
    return named | {kind for kinds in TERMS.values() for kind in kinds.values()}


EXPORTED = exported()
FUNCTIONS = sorted((f for f in EXPORTED if inspect.isfunction(f)), key=lambda f: f.__qualname__)


def has_sections(kind):
    sections = re.search(r"^(Parameters|Attributes)\n-+$", inspect.getdoc(kind) or "", re.MULTILINE)
    return kind in EXPORTED or sections is not None


CLASSES = [kind for kind in sources.public_classes() if has_sections(kind)]


def documented(doc, *sections):
    return [
        name.strip().lstrip("*")
        for section in sections
        for parameter in doc[section]
        for name in parameter.name.split(",")
    ]


def lent_to(subject):
    """Arguments that are documented where a docstring says, "as in `SpoofEnv`", or as settings."""
    said = re.findall(
        r"(?:as in|those of|world of) `(?:\w+\.)*(\w+)`", inspect.getdoc(subject), re.I
    )
    lenders = [kind for kind in EXPORTED if kind.__name__ in said and inspect.isclass(kind)]
    functions = [kind for kind in EXPORTED if kind.__name__ in said and inspect.isfunction(kind)]
    docs = [*map(ClassDoc, lenders), *map(FunctionDoc, functions)]
    own = ClassDoc(subject) if inspect.isclass(subject) else FunctionDoc(subject)
    listed = [line for part in own["Parameters"] if part.name == "**settings" for line in part.desc]
    named = re.findall(r"``(\w+)``", "\n".join(listed))
    return {*named, *(name for doc in docs for name in documented(doc, "Parameters"))}


def check_arguments(subject, told, arguments):
    """Every argument is documented here, or where the docstring says, and nothing else is."""
    lent = lent_to(subject)
    missing = [name for name in arguments if name not in told and name not in lent]
    unknown = [name for name in told if name not in arguments and (name != "settings" or not lent)]
    assert (subject.__qualname__, missing, unknown) == (subject.__qualname__, [], [])


def fields_of(kind):
    """Fields of a dataclass or a named tuple, else None."""
    if dataclasses.is_dataclass(kind):
        return [field.name for field in dataclasses.fields(kind) if field.init]
    if issubclass(kind, tuple) and hasattr(kind, "_fields"):
        return list(kind._fields)
    return None


def test_every_field_is_documented():
    for kind in CLASSES:
        fields = fields_of(kind)
        if fields is None:
            continue
        doc = ClassDoc(kind)
        told = documented(doc, "Parameters", "Attributes")
        assert [name for name in fields if name not in told] == [], kind
        if dataclasses.is_dataclass(kind):
            assert set(documented(doc, "Parameters")) <= set(fields), kind


def test_every_argument_is_documented():
    for kind in CLASSES:
        protocol = getattr(kind, "_is_protocol", False)
        if protocol or fields_of(kind) is not None or "__init__" not in vars(kind):
            continue
        told = documented(ClassDoc(kind), "Parameters")
        expanded = "__signature__" in vars(kind) and "settings" not in told
        signed = inspect.signature(kind if expanded else kind.__init__)
        arguments = [name for name in signed.parameters if name != "self"]
        if kind.__init__.__doc__:
            told += documented(FunctionDoc(kind.__init__), "Parameters")
        if issubclass(kind, dict) and not told:  # a container with a default of its own
            continue
        assert len(set(told)) == len(told), kind
        check_arguments(kind, told, arguments)


def test_every_exported_function_is_documented_and_linted():
    for function in FUNCTIONS:
        doc, signature = FunctionDoc(function), inspect.signature(function)
        arguments, told = list(signature.parameters), documented(doc, "Parameters")
        check_arguments(function, told, arguments)
        order = [name for name in told if name in arguments]
        assert order == [name for name in arguments if name in order], function
        if signature.return_annotation not in (None, "None"):
            assert doc["Returns"] or doc["Yields"] or not arguments, function
        stem = function.__module__.rsplit(".", 1)[-1]
        package = inspect.getsourcefile(function).endswith("__init__.py")
        name = f"{'__init__' if package else stem}.{function.__qualname__}"
        assert not LEFT_OUT.search(name)


KEYS = re.findall(r"^@\w+\{([^,\s]+),", (sources.CHECKOUT / "references.bib").read_text(), re.M)
CITED = re.compile(r"`([a-z]{2,}(?:19|20)\d\d[a-z]?)`")
AUDIT = "audit_worlds.py", "spoofgym.testing.detector"
"""An audit checks the contract of a foreign detector first."""


def test_what_detectors_and_docstrings_cite_is_known_by_keys_that_are_unique():
    assert len({*KEYS}) == len(KEYS) > 0
    cited = {key for path in sources.files() for key in CITED.findall(path.read_text())}
    assert cited | {kind.paper for kind in DETECTORS.values()} <= {*KEYS}
    assert len(cited) > 20


def test_nothing_of_the_library_needs_its_own_checks():
    """`spoofgym.testing` is for users and tests: it may import, but is not imported."""
    for path in sources.files():
        if path.relative_to(sources.ROOT).parts[0] == "testing":
            continue
        for module, names in sources.imports_of(path):
            if (path.name, module) == AUDIT:
                continue
            assert module.split(".")[:2] != ["spoofgym", "testing"], path
            assert module != "spoofgym" or "testing" not in names, path
