"""How long a file may be, what may not be written, and what annotations may not say: docs/decisions/0002-layout.md.

Each rule is one test that lists all offenders.
"""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

from sources import Source, everything, offenders, read, sources

BANNED_MODULES = {"pickle", "cPickle", "dill", "cloudpickle", "shelve", "marshal", "yaml"}
AMBIGUOUS_MODULES = {"conftest"}
"""There is one in several folders, and which of them an import finds depends on what was collected before."""
BANNED_CALLS = {"eval", "exec", "os.system", "yaml.load"}
BANNED_ARGUMENTS = {"allow_pickle", "shell"}

MAX_FILE_LINES = 350
MAX_FUNCTION_LINES = 80
"""Most functions stay below 40; this is the very most."""
ROUNDING = 1e-5
"""Tolerances up to this are for rounding errors; larger ones for models, noise and files' digits."""


def test_files_and_functions_are_small() -> None:
    wrong = []
    for source in everything():
        lines = len(source.text.splitlines())
        if lines > MAX_FILE_LINES:
            wrong.append((source, f"{lines} lines"))
        for node in ast.walk(source.tree):
            if isinstance(node, ast.FunctionDef):
                lines = (node.end_lineno or 0) - node.lineno + 1
                if lines > MAX_FUNCTION_LINES:
                    wrong.append((source, f"{node.name} has {lines} lines"))
    assert offenders(wrong) == []


def banned(source: Source) -> Iterator[str]:
    """What a file does that nothing here may do: run data as code, import by chance, or hide an error."""
    for item in source.imports():
        if item.module.split(".")[0] in BANNED_MODULES | AMBIGUOUS_MODULES:
            yield f"line {item.line}: import {item.module}"
    for node in ast.walk(source.tree):
        if isinstance(node, ast.ExceptHandler) and node.type is None:
            yield f"line {node.lineno}: bare except"
        if isinstance(node, ast.Call):
            if ast.unparse(node.func) in BANNED_CALLS:
                yield f"line {node.lineno}: {ast.unparse(node.func)}("
            for argument in node.keywords:
                false = isinstance(argument.value, ast.Constant) and argument.value.value is False
                if argument.arg in BANNED_ARGUMENTS and not false:
                    yield f"line {node.lineno}: {argument.arg}={ast.unparse(argument.value)}"


def test_nothing_banned_is_written() -> None:
    assert offenders((source, text) for source in everything() for text in banned(source)) == []


def test_import_has_no_side_effects() -> None:
    """No flags, environment, files or output at import: no such call outside a function or a class."""
    forbidden = re.compile(r"config\.update|environ|^print$|^open$|read_text|np\.load|filterwarnings|\.use$")
    wrong = []
    for source in sources("jaxplan"):
        top = [node for node in source.tree.body if not isinstance(node, ast.FunctionDef | ast.ClassDef | ast.If)]
        calls = [ast.unparse(node.func) for part in top for node in ast.walk(part) if isinstance(node, ast.Call)]
        wrong += [(source, call) for call in calls if forbidden.search(call)]
    assert offenders(wrong) == []


def loose_callables(source: Source) -> Iterator[str]:
    """``Callable[..., X]`` as the type of a field: what it is called with is a Protocol's to say."""
    for node in ast.walk(source.tree):
        if isinstance(node, ast.ClassDef):
            for field in node.body:
                if isinstance(field, ast.AnnAssign) and "Callable[..." in ast.unparse(field.annotation):
                    yield f"line {field.lineno}: {node.name}.{ast.unparse(field.target)}"


def test_fields_that_are_called_say_with_what() -> None:
    assert offenders((source, text) for source in sources("jaxplan") for text in loose_callables(source)) == []


def symbolic_arguments(source: Source) -> Iterator[str]:
    """Shapes such as ``m+1`` on arguments, which are read before ``m`` is known."""
    for node in ast.walk(source.tree):
        if isinstance(node, ast.FunctionDef):
            given = node.args
            for argument in (*given.posonlyargs, *given.args, *given.kwonlyargs):
                if argument.annotation is not None and re.search(
                    r"\"[^\"]*\w[+*/-]\d[^\"]*\"|'[^']*\w[+*/-]\d[^']*'", ast.unparse(argument.annotation)
                ):
                    yield f"line {argument.lineno}: {node.name}({argument.arg})"


def test_shapes_of_arguments_have_plain_names() -> None:
    assert offenders((source, text) for source in sources("jaxplan") for text in symbolic_arguments(source)) == []


def unbound_results(source: Source) -> Iterator[str]:
    """Shapes such as ``m+1`` on results of functions none of whose arguments say what ``m`` is."""
    for node in ast.walk(source.tree):
        if isinstance(node, ast.FunctionDef) and node.returns is not None:
            given = (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)
            known = {name for a in given if a.annotation for text in texts(a.annotation) for name in text.split()}
            for token in (token for text in texts(node.returns) for token in text.split()):
                if re.fullmatch(r"\w+([-+*/]\w+)+", token) and not set(re.findall(r"[a-z_]\w*", token)) <= known:
                    yield f"line {node.lineno}: {node.name} -> {token}"


def texts(node: ast.AST) -> Iterator[str]:
    """The strings below a node."""
    for child in ast.walk(node):
        if isinstance(child, ast.Constant) and isinstance(child.value, str):
            yield child.value


def test_shapes_of_results_are_made_of_those_of_arguments() -> None:
    assert offenders((source, text) for source in sources("jaxplan") for text in unbound_results(source)) == []


def private_tolerances(source: Source) -> Iterator[str]:
    """Tolerances for rounding errors written as a number, not taken from the table, without a reason beside them."""
    lines = source.text.splitlines()
    for node in ast.walk(source.tree):
        if isinstance(node, ast.keyword) and node.arg in {"rtol", "atol", "rel", "abs"}:
            value = node.value.value if isinstance(node.value, ast.Constant) else None
            line = lines[node.lineno - 1]
            if isinstance(value, float) and 0.0 < value <= ROUNDING and "#" not in line:
                yield f"line {node.lineno}: {line.strip()}"


def test_tolerances_for_rounding_come_from_the_one_table() -> None:
    tests = sources("tests/unit", "tests/integration")
    assert offenders((source, text) for source in tests for text in private_tolerances(source)) == []


def written(folder: Path, text: str) -> Source:
    (folder / "bad.py").write_text(text)
    return read(folder / "bad.py", folder)


def test_the_bans_themselves(tmp_path: Path) -> None:
    text = (
        "import pickle\nimport yaml\nfrom conftest import counter\neval('1')\nnp.load(f, allow_pickle=True)\n"
        "run(c, shell=True)\ntry:\n    pass\nexcept:\n    pass\nnp.load(f, allow_pickle=False)\n"
    )
    assert len(list(banned(written(tmp_path, text)))) == 7


def test_the_rule_of_tolerances_itself(tmp_path: Path) -> None:
    text = "close(a, rtol=1e-9)\nclose(a, atol=1e-9)  # why\nclose(a, atol=1e-3)\nclose(a, atol=1e-9 * scale)\n"
    assert [found[:6] for found in private_tolerances(written(tmp_path, text))] == ["line 1"]


def test_the_rules_of_types_themselves(tmp_path: Path) -> None:
    text = (
        "class A:\n    call: Callable[..., int]\n    fine: Callable[[int], int]\n"
        "def f(x: Float[Array, 'm+1 3'], y: Float[Array, 'm 3']) -> Float[Array, 'm+1']: ...\n"
    )
    source = written(tmp_path, text)
    assert list(loose_callables(source)) == ["line 2: A.call"]
    assert list(symbolic_arguments(source)) == ["line 4: f(x)"]
    assert list(unbound_results(written(tmp_path, "def f(x: Float[Array, 'n']) -> Float[Array, 'm+1']: ...\n"))) != []
    assert list(unbound_results(written(tmp_path, "def f(x: Float[Array, 'm']) -> Float[Array, 'm+1']: ...\n"))) == []
