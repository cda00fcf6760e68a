"""What docstrings of public names must say, as far as it can be checked: names, shapes, statuses, errors, sources."""

import dataclasses
import inspect
import re

import pytest

import lyaphybrid as lh
from lyaphybrid import _renamed as renamed
from lyaphybrid.results.result import Result, RunResult

FUNCTIONS = {name: getattr(lh, name) for name in lh.__all__ if inspect.isfunction(getattr(lh, name))}
PLOTS = {name: getattr(lh.plots, name) for name in lh.plots.__all__ if inspect.isfunction(getattr(lh.plots, name))}
CLASSES = {name: getattr(lh, name) for name in lh.__all__ if inspect.isclass(getattr(lh, name))} | {
    name: getattr(lh.zoo, name) for name in ("Problem", "Reference", "CollisionStatistics")
}
RESULTS = {name: kind for name, kind in CLASSES.items() if issubclass(kind, Result)}
SYSTEMS = {"Flow", "Map", "Hybrid", "EventDriven", "Hamiltonian", "DAE"}  # of methods `Method` describes the protocol
SECTIONS = ("Args", "Returns", "Raises", "Source", "Example", "Attributes")


def sections_of(described: str) -> dict[str, str]:
    """The sections of a docstring; "" is what stands before them."""
    parts = re.split(rf"^({'|'.join(SECTIONS)}):$", described, flags=re.MULTILINE)
    return {"": parts[0], **dict(zip(parts[1::2], parts[2::2], strict=True))}


def entries_of(section: str, several: bool = False) -> dict[str, str]:
    """The names that a section lists, each with its text; `t1, transient: …` are two, and `a: …; b: …` if `several`."""
    found: dict[str, str] = {}
    for one in re.split(r"\n(?= {4}\S)", "\n" + section):
        names, colon, text = one.strip().partition(":")
        for name in names.split(", ") if colon else []:
            found[name.strip("`*")] = text
            found |= dict.fromkeys(re.findall(r"[;.] `?(\w+)`?:", text), text) if several else {}
    return found


def unannotated(function) -> list[str]:
    signature = inspect.signature(function)
    parameters = [one for one in signature.parameters.values() if one.name not in ("self", "cls")]
    missing = [one.name for one in parameters if one.annotation is inspect.Parameter.empty]
    return missing if signature.return_annotation is not inspect.Signature.empty else [*missing, "return"]


def of_one_class(kind: type) -> dict[str, object]:
    """The public methods and properties that a class itself defines, as functions."""
    found = {}
    for name, value in vars(kind).items():
        function = getattr(value, "fget", None) or getattr(value, "__func__", value)
        function = inspect.unwrap(function) if callable(function) else function
        if not name.startswith("_") and inspect.isfunction(function) and function.__module__ != renamed.__name__:
            found[name] = function
    return found


METHODS = {
    f"{owner}.{name}": function
    for owner, kind in CLASSES.items()
    if owner in SYSTEMS or issubclass(kind, Result) or owner == "Problem"
    for name, function in of_one_class(kind).items()
}


DESCRIBED = FUNCTIONS | {f"plots.{name}": one for name, one in PLOTS.items()}
DESCRIBED |= {f"zoo.{name}": getattr(lh.zoo, name) for name in lh.zoo.names()}


@pytest.mark.parametrize("name", DESCRIBED)
def test_a_function_describes_each_argument(name):
    """By name and in the order of the signature; what it returns, and an example."""
    function = DESCRIBED[name]
    described = sections_of(inspect.getdoc(function) or "")
    assert described[""].strip().splitlines()[0].endswith((".", ":"))
    assert list(entries_of(described["Args"])) == list(inspect.signature(function).parameters)
    assert described["Returns"].strip()
    assert ">>>" in described["Example"]
    assert unannotated(function) == []


@pytest.mark.parametrize("name", FUNCTIONS)
def test_a_function_says_its_errors_and_where_it_is_from(name):
    """A ValueError for arguments, RunFailedError and the like for what fails in mid-run; a source can be found."""
    function = FUNCTIONS[name]
    described = sections_of(inspect.getdoc(function) or "")
    raised = described["Raises"]
    assert "ValueError" in raised or "TypeError" in raised
    if "throw" in inspect.signature(function).parameters:
        assert re.search(r"(RunFailed|NoPeriodicOrbit)Error: .*throw", raised, re.DOTALL)
    if "Source" in described:
        assert re.search(r"doi:10\.\d{4}|ISBN|https?://|[12]\d{3}", described["Source"])


@pytest.mark.parametrize("name", [name for name in FUNCTIONS if "x0" in inspect.signature(FUNCTIONS[name]).parameters])
def test_a_state_is_given_with_its_shape(name):
    text = entries_of(sections_of(inspect.getdoc(FUNCTIONS[name]) or "")["Args"])["x0"]
    assert re.search(r"\((n|dim|m|2),.*?\)|\(n\b|as for `lh\.", text)


@pytest.mark.parametrize("name", RESULTS)
def test_a_result_describes_each_attribute(name):
    """A field in the docstring of its class or, if all results have it, of their base; a property has its own."""
    kind = RESULTS[name]
    listed = entries_of(sections_of(inspect.getdoc(kind) or "")["Attributes"], several=True)
    shared = entries_of(sections_of(inspect.getdoc(Result) or "")["Attributes"], several=True)
    own = [one.name for one in dataclasses.fields(kind)] if dataclasses.is_dataclass(kind) else []
    own = [*own, *getattr(kind, "_fields", ())]
    assert [one for one in own if one not in listed and one not in shared and not one.startswith("_")] == []
    assert not issubclass(kind, RunResult) or "status" in listed
    assert ">>>" in sections_of(inspect.getdoc(kind) or "")["Example"]


@pytest.mark.parametrize("name", METHODS)
def test_a_method_is_described_and_annotated(name):
    function = METHODS[name]
    described = inspect.getdoc(function) or ""
    assert described.splitlines()
    assert unannotated(function) == []
    parameters = [
        one for one in inspect.signature(function).parameters if one not in ("self", "cls", "ax", "overrides")
    ]
    assert [one for one in parameters if not re.search(rf"\b{one}\b", described)] == []


@pytest.mark.parametrize("status", [status for status in lh.STATUS if status.failed], ids=lambda status: status.name)
def test_a_failure_says_its_causes_or_what_to_do(status):
    assert re.search(r"\(a\).*\(b\)|; (raise|make)", status.meaning)
