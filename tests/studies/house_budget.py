"""What the code may grow to: python tests/studies/house_budget.py [--store]

`house_budget.json` has the most that each folder may have, which `tests/test_budget.py` holds. A change that makes the
code smaller stores a lower budget; a feature that needs more adds a line to `features`, with its tokens and its reason.

Counted are the tokens of each folder of the package, of the tests, studies and benchmarks, without comments, ends of
lines and indentation, and without annotations and the names of keyword arguments, which are worth their tokens; the
bytes of .json, .html, .js and .css in the package; its modules; assignments such as `a, b = x, y(z)`, of several values
whose right sides are not of one kind; records such as `Record(*a, b)` that splats fill, of which there are none; and
the share of annotated arguments, in parts per thousand, of which the least
is stored, where of all others it is the most.
"""

import argparse
import ast
import io
import json
import tokenize
from collections import Counter
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[2]
PACKAGE = "jaxshroud"
FILE = Path(__file__).with_suffix(".json")
OTHER = (".json", ".html", ".js", ".css")
TESTS = {"tests/studies": "studies", "tests/benchmarks": "benchmarks"}
UNCOUNTED = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENCODING,
    tokenize.ENDMARKER,
}
Functions = ast.FunctionDef | ast.AsyncFunctionDef


def tokens_of(source: str) -> list[tokenize.TokenInfo]:
    """The tokens of a source that are counted; a docstring is one."""
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    return [token for token in tokens if token.type not in UNCOUNTED]


def room_of(path: Path) -> str:
    """The room of a file, by its path in the repository: a folder of the package, or the tests, studies, benchmarks."""
    parts = path.parts
    if parts[0] == PACKAGE:
        return f"{PACKAGE}/{parts[1]}" if len(parts) > 2 else PACKAGE
    return TESTS.get("/".join(parts[:2]), "tests")


@cache
def nodes_of(tree: ast.Module) -> list[ast.AST]:
    """All nodes of a tree of the package, listed once."""
    return [*ast.walk(tree)]


def worth_their_tokens(tree: ast.Module) -> Iterator[tuple[tuple[int, int], tuple[int, int]]]:
    """Where annotations and the names of keyword arguments stand: (line, column) of the first and behind the last."""
    for node in ast.walk(tree):
        for name in ("annotation", "returns"):
            noted = getattr(node, name, None)
            if isinstance(noted, ast.expr):
                yield _place(noted)
        if isinstance(node, ast.keyword) and node.arg is not None:
            yield (node.lineno, node.col_offset), (node.value.lineno, node.value.col_offset)


def _place(node: ast.expr) -> tuple[tuple[int, int], tuple[int, int]]:
    assert node.end_lineno is not None
    assert node.end_col_offset is not None
    return (node.lineno, node.col_offset), (node.end_lineno, node.end_col_offset)


def counted_tokens(source: str) -> int:
    """The tokens of a source without what is worth them."""
    spared = list(worth_their_tokens(ast.parse(source)))
    by_line: dict[int, list[tuple[tuple[int, int], tuple[int, int]]]] = {}
    for first, behind in spared:
        for line in range(first[0], behind[0] + 1):
            by_line.setdefault(line, []).append((first, behind))
    return sum(
        not any(first <= token.start < behind for first, behind in by_line.get(token.start[0], ()))
        for token in tokens_of(source)
    )


def kind_of(value: ast.expr) -> tuple[str, str]:
    """The kind of a right side, by which several are alike."""
    if isinstance(value, ast.UnaryOp) and isinstance(value.operand, ast.Constant):
        value = value.operand
    if isinstance(value, ast.Constant):
        return "constant", "number" if isinstance(value.value, int | float) else type(value.value).__name__
    if isinstance(value, ast.Call):
        return "call", ast.dump(value.func)
    if isinstance(value, ast.BinOp):
        return "operation", type(value.op).__name__
    return type(value).__name__, ""


def is_unlike(node: ast.AST) -> bool:
    """Whether a node assigns several values at once whose right sides are not of one kind."""
    if not isinstance(node, ast.Assign) or not isinstance(node.value, ast.Tuple):
        return False
    values = node.value.elts
    packed = any(isinstance(target, ast.Tuple) for target in node.targets)
    return packed and not any(isinstance(v, ast.Starred) for v in values) and len({*map(kind_of, values)}) > 1


def is_record(node: ast.AST) -> bool:
    """Whether a node is the class of a record: a NamedTuple, a dataclass or a module of Equinox."""
    if not isinstance(node, ast.ClassDef):
        return False
    bases = {base.split(".")[-1] for base in map(ast.unparse, node.bases)}
    return bool(bases & {"NamedTuple", "Module"}) or any("dataclass" in ast.unparse(d) for d in node.decorator_list)


def splats_into_records(trees: Iterable[ast.Module]) -> int:
    """How many records of some sources are filled by position from what a splat gives."""
    nodes = [node for tree in trees for node in nodes_of(tree)]
    records = {node.name for node in nodes if isinstance(node, ast.ClassDef) and is_record(node)}
    calls = [
        node for node in nodes if isinstance(node, ast.Call) and any(isinstance(a, ast.Starred) for a in node.args)
    ]
    return sum(ast.unparse(call.func).split(".")[-1] in records for call in calls)


def annotated_share(trees: Iterable[ast.Module]) -> int:
    """The share of arguments with an annotation, in parts per thousand."""
    functions = (node for tree in trees for node in nodes_of(tree) if isinstance(node, Functions))
    arguments = [
        argument
        for function in functions
        for argument in (*function.args.posonlyargs, *function.args.args, *function.args.kwonlyargs)
        if argument.arg not in ("self", "cls")
    ]
    return 1000 * sum(argument.annotation is not None for argument in arguments) // len(arguments)


def counts(root: Path = ROOT) -> dict[str, int]:
    """All that has a budget."""
    package = {path: path.read_text("utf-8") for path in sorted((root / PACKAGE).rglob("*.py"))}
    tests = {path: path.read_text("utf-8") for path in sorted((root / "tests").rglob("*.py"))}
    tokens: Counter[str] = Counter()
    for path, source in (package | tests).items():
        tokens[room_of(path.relative_to(root))] += counted_tokens(source)
    trees = {path: ast.parse(source) for path, source in package.items()}
    unlike: Counter[str] = Counter()
    for path, tree in trees.items():
        unlike[room_of(path.relative_to(root))] += sum(map(is_unlike, nodes_of(tree)))
    others = [path for path in (root / PACKAGE).rglob("*") if path.suffix in OTHER]
    return {
        **{f"tokens of {room}": count for room, count in sorted(tokens.items())},
        **{f"unlike assignments of {room}": count for room, count in sorted(unlike.items())},
        "other bytes": sum(path.stat().st_size for path in others),
        "modules": sum(path.name != "__init__.py" for path in package),
        "splats into records": splats_into_records(trees.values()),
        "annotated arguments": annotated_share(trees.values()),
    }


def overdrawn(found: dict[str, int], budget: dict) -> list[str]:
    """What is beyond its budget, with what features have added to it."""
    allowed = Counter(budget["most"])
    for feature in budget["features"]:
        allowed.update(feature["adds"])
    most = {name: count for name, count in found.items() if name != "annotated arguments"}
    told = [f"{name}: {count}, at most {allowed[name]}" for name, count in most.items() if count > allowed[name]]
    share, least = found["annotated arguments"], budget["least"]["annotated arguments"]
    return told + ([f"annotated arguments: {share}, at least {least}"] if share < least else [])


def main() -> None:
    """Print what is counted beside its budget, and store it where asked to."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--store", action="store_true", help="write what is counted as the budget")
    found = counts()
    if parser.parse_args().store:
        share = found["annotated arguments"]
        most = {name: count for name, count in found.items() if name != "annotated arguments"}
        budget = {"most": most, "least": {"annotated arguments": share}, "features": []}
        FILE.write_text(json.dumps(budget, indent=1) + "\n", "utf-8")
    budget = json.loads(FILE.read_text("utf-8"))
    for name, count in found.items():
        print(f"{name:44}{budget['most'].get(name, budget['least'].get(name, 0)):>10}{count:>10}")
    print(*overdrawn(found, budget), sep="\n")


if __name__ == "__main__":
    main()
