"""The stub says of every function the parameters and defaults that it has."""

import ast
import inspect
from pathlib import Path

import pytest

import udc

STUB = ast.parse((Path(udc.__file__).with_name("__init__.pyi")).read_text(encoding="utf-8"))


def functions():
    """The first definition of each function of the stub, and the methods of Degrader."""
    found = {}
    for node in STUB.body:
        if isinstance(node, ast.FunctionDef):
            found.setdefault(node.name, node)
        if isinstance(node, ast.ClassDef) and node.name == "Degrader":
            found.update({f"Degrader.{each.name}": each for each in node.body if isinstance(each, ast.FunctionDef)})
    return found


def defaults_of_stub(node):
    args = node.args
    positional = [arg.arg for arg in args.args]
    found = dict.fromkeys(positional + [arg.arg for arg in args.kwonlyargs], inspect.Parameter.empty)
    found.update(zip(positional[len(positional) - len(args.defaults) :], map(ast.literal_eval, args.defaults)))
    keywords = zip(args.kwonlyargs, args.kw_defaults)
    found.update({arg.arg: ast.literal_eval(default) for arg, default in keywords if default is not None})
    return found


def test_the_stub_names_all_that_there_is():
    classes = {node.name for node in STUB.body if isinstance(node, ast.ClassDef)}
    names = classes | {name for name in functions() if "." not in name} | {"__version__"}
    assert names == set(udc.__all__)


@pytest.mark.parametrize("name", [name for name in functions() if name not in ("Degrader.names", "Degrader.info", "set_threads")])
def test_parameters_and_defaults_are_those_of_the_stub(name):
    found = udc
    for part in name.split("."):
        found = getattr(found, part)
    parameters = inspect.signature(found).parameters
    expected = {key: value.default for key, value in parameters.items() if value.kind is not value.VAR_KEYWORD}
    if name == "degrade":
        formation = inspect.signature(udc.Degrader.__init__).parameters
        expected.update({key: value.default for key, value in formation.items() if key not in ("self", "psf", "bank")})
    assert defaults_of_stub(functions()[name]) == expected
