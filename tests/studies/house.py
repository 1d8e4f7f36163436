"""How much code there is, and how often it forks on row or pair: python tests/studies/house.py

Counted in the syntax of the package, which is not imported. The table shows the baseline in `house.json`, the code at
hand, and their ratio; `--store` writes the baseline, `--forks` prints every fork.

| counted | what it is |
|---|---|
| forks | tests on row or pair, see `house_forks`; those of the row's kernels and those outside |
| forks passed on | calls with a fork among their arguments, which is tested elsewhere; not in the sum of forks |
| sizes or None | annotations `RowSize | None` |
| lines with in_row | those that hold this name |
| classes of rows | those whose names begin with "Row" and a capital |
| modules | those that are not `__init__`; small ones have fewer than 60 lines of code, large ones more than 350 lines |
| with one importer | modules that exactly one other module imports, inside functions too |
| tokens | without comments, ends of lines and indentation; the tree is taken to be formatted by `ruff format` |
| lines of code | those with a token that is neither a comment nor a docstring |
| import lines | lines of all import statements |
| public names | what `jaxshroud/__init__.pyi` and `__init__.py` re-export; methods are not among them |
| packed tuples | assignments such as `a, b = x, y` |
| bound lambdas | assignments such as `name = lambda ...` |
"""

import argparse
import ast
import io
import json
import re
import tokenize
from collections.abc import Iterable, Iterator, Mapping
from fnmatch import fnmatch
from functools import cache
from pathlib import Path

from house_forks import Module, modules_of

KERNELS = ("model/row*.py", "march/row_*.py", "batch/row_*.py", "batch/rows.py")  # of rows, within the package
ROOT, PACKAGE, COMMAND = Path(__file__).parents[2], "jaxshroud", "jaxshroud_command.py"
FILE = Path(__file__).with_suffix(".json")
SMALL, LARGE = 60, 350  # lines of code, and lines, of modules
MOST_SHOWN = 20  # modules with forks
UNCOUNTED = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENCODING,
    tokenize.ENDMARKER,
}
HOLDERS = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)  # of docstrings
Counts = dict[str, int]


def sources_in(root: Path) -> dict[str, str]:
    """The modules of a tree by their paths."""
    paths = [*sorted((root / PACKAGE).rglob("*.py")), root / COMMAND]
    return {path.relative_to(root).as_posix(): path.read_text() for path in paths}


def is_kernel(path: str) -> bool:
    """Whether a module is one of the row's kernels."""
    return any(fnmatch(path, f"{PACKAGE}/{pattern}") for pattern in KERNELS)


@cache
def tokens_of(source: str) -> list[tokenize.TokenInfo]:
    """The tokens of a source that are counted; a docstring is one."""
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    return [token for token in tokens if token.type not in UNCOUNTED]


def docstrings_of(tree: ast.Module) -> set[tuple[int, int]]:
    """Where docstrings begin: line and column."""
    holders = (n for n in ast.walk(tree) if isinstance(n, HOLDERS))
    firsts = (holder.body[0] for holder in holders if holder.body)
    return {
        (first.lineno, first.col_offset)
        for first in firsts
        if isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant) and isinstance(first.value.value, str)
    }


def code_lines(source: str, tree: ast.Module) -> int:
    """The number of lines that hold a token other than a comment or a docstring."""
    docstrings = docstrings_of(tree)
    tokens = [token for token in tokens_of(source) if token.start not in docstrings]
    return len({line for token in tokens for line in range(token.start[0], token.end[0] + 1)})


def import_statements(node: ast.AST) -> list[ast.Import | ast.ImportFrom]:
    """All imports within a node."""
    return [inner for inner in ast.walk(node) if isinstance(inner, ast.Import | ast.ImportFrom)]


def imports_inside_functions(tree: ast.Module) -> int:
    """The number of import statements inside functions."""
    functions = [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)]
    return len({id(statement) for function in functions for statement in import_statements(function)})


def module_name(path: str) -> str:
    """The name of a module by its path."""
    return path.removesuffix(".py").removesuffix("/__init__").replace("/", ".")


def importers(trees: Mapping[str, ast.Module]) -> dict[str, set[str]]:
    """The modules that import each module."""
    names = {module_name(path): path for path in trees}
    found: dict[str, set[str]] = {path: set() for path in trees}
    for path, tree in trees.items():
        for name in imported_names(tree):
            used = names.get(name) or names.get(name.rpartition(".")[0])
            if used and used != path:
                found[used].add(path)
    return found


def imported_names(tree: ast.Module) -> Iterator[str]:
    """Full names of all that a module imports."""
    for statement in import_statements(tree):
        prefix = f"{statement.module}." if isinstance(statement, ast.ImportFrom) else ""
        yield from (prefix + alias.name for alias in statement.names)


def public_names(sources: Iterable[str]) -> set[str]:
    """The names that the package re-exports: `name as name`, and those listed in `__all__`."""
    trees = [ast.parse(source) for source in sources]
    aliases = (a for tree in trees for statement in import_statements(tree) for a in statement.names)
    listed = (
        word.value
        for tree in trees
        for node in tree.body
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__"
        for word in ast.walk(node.value)
        if isinstance(word, ast.Constant)
    )
    names = {alias.name for alias in aliases if alias.asname == alias.name} | set(listed)
    return {name for name in names if not name.startswith("_")}


def is_packed(node: ast.AST) -> bool:
    """Whether a node assigns several values at once."""
    if not isinstance(node, ast.Assign) or not isinstance(node.value, ast.Tuple):
        return False
    return any(isinstance(target, ast.Tuple) for target in node.targets)


def is_bound_lambda(node: ast.AST) -> bool:
    """Whether a node gives a name to a lambda."""
    if not isinstance(node, ast.Assign | ast.AnnAssign) or not isinstance(node.value, ast.Lambda):
        return False
    targets = node.targets if isinstance(node, ast.Assign) else [node.target]
    return any(isinstance(target, ast.Name) for target in targets)


def sizes_or_none(tree: ast.Module) -> int:
    """The number of annotations with a size of a row or None."""
    nodes = list(ast.walk(tree))
    annotations = [getattr(node, name, None) for node in nodes for name in ("annotation", "returns")]
    told = [ast.unparse(annotation) for annotation in annotations if isinstance(annotation, ast.AST)]
    return sum(bool(re.search(r"\bRowSize \| None", text)) for text in told)


def classes_of_rows(tree: ast.Module) -> int:
    """The number of classes that are named after rows."""
    classes = [node for node in ast.walk(tree) if isinstance(node, ast.ClassDef)]
    return sum(bool(re.match(r"_?Row[A-Z]", node.name)) for node in classes)


def fork_totals(modules: Mapping[str, Module]) -> Counts:
    """The numbers of forks, and of what is told with them."""
    forks = {path: len(module.forks) for path, module in modules.items()}
    kernels = sum(count for path, count in forks.items() if is_kernel(path))
    return {
        "forks": sum(forks.values()),
        "forks in the row's kernels": kernels,
        "forks outside": sum(forks.values()) - kernels,
        "modules with forks": sum(map(bool, forks.values())),
        "forks passed on": sum(module.passed for module in modules.values()),
    }


def code_totals(sources: Mapping[str, str]) -> Counts:
    """The numbers of modules, lines, tokens and imports, and of what is written in a way that is to be told."""
    trees = {path: ast.parse(source) for path, source in sources.items()}
    named = {path: source for path, source in sources.items() if not path.endswith("__init__.py")}
    code = {path: code_lines(source, trees[path]) for path, source in sources.items()}
    lines = {path: len(source.splitlines()) for path, source in sources.items()}
    used = importers(trees)
    nodes = [node for tree in trees.values() for node in ast.walk(tree)]
    imports = [statement for tree in trees.values() for statement in import_statements(tree)]
    return {
        "sizes or None": sum(map(sizes_or_none, trees.values())),
        "lines with in_row": sum(len(re.findall(r"(?m)^.*\bin_row\b.*$", source)) for source in sources.values()),
        "classes of rows": sum(map(classes_of_rows, trees.values())),
        "modules": len(named),
        "small modules": sum(code[path] < SMALL for path in named),
        "large modules": sum(lines[path] > LARGE for path in named),
        "modules with one importer": sum(len(used[path]) == 1 for path in named),
        "tokens": sum(len(tokens_of(source)) for source in sources.values()),
        "lines": sum(lines.values()),
        "lines of code": sum(code.values()),
        "import lines": sum(s.end_lineno - s.lineno + 1 for s in imports),
        "imports inside functions": sum(map(imports_inside_functions, trees.values())),
        "packed tuples": sum(map(is_packed, nodes)),
        "bound lambdas": sum(map(is_bound_lambda, nodes)),
    }


def public_total(root: Path) -> Counts:
    """The number of public names."""
    paths = [root / PACKAGE / name for name in ("__init__.py", "__init__.pyi")]
    return {"public names": len(public_names(path.read_text() for path in paths if path.exists()))}


def table(now: Counts, before: Counts) -> Iterator[str]:
    """The lines of the table of totals."""
    yield f"{'':28}{'baseline':>10}{'now':>10}{'ratio':>8}"
    for name, count in now.items():
        then = before.get(name)
        ratio = f"{count / then:8.2f}" if then else f"{'':>8}"
        yield f"{name:28}{'-' if then is None else then:>10}{count:>10}{ratio}"


def most_forked(forks: Counts, before: Counts) -> Iterator[str]:
    """The lines of a table of the modules with most forks."""
    for path, count in sorted(forks.items(), key=lambda item: (-item[1], item[0]))[:MOST_SHOWN]:
        yield f"{path:48}{before.get(path, 0):>10}{count:>6}"


def fork_lines(modules: Mapping[str, Module], sources: Mapping[str, str]) -> Iterator[str]:
    """Every fork as path, line and source."""
    for path, module in modules.items():
        lines = sources[path].splitlines()
        yield from (f"{path}:{fork.line}: {lines[fork.line - 1].strip()}" for fork in sorted(module.forks))


def main() -> None:
    """Count, print, and store where asked to."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--store", action="store_true", help="write what is counted as the baseline")
    parser.add_argument("--forks", action="store_true", help="print every fork")
    options = parser.parse_args()
    sources = sources_in(ROOT)
    modules = modules_of(sources)
    totals = fork_totals(modules) | code_totals(sources) | public_total(ROOT)
    forks = {path: len(module.forks) for path, module in modules.items() if module.forks}
    if options.store:
        FILE.write_text(json.dumps({"totals": totals, "forks": forks}, indent=1, sort_keys=True) + "\n")
    stored = json.loads(FILE.read_text()) if FILE.exists() else {"totals": {}, "forks": {}}
    print(*table(totals, stored["totals"]), "", *most_forked(forks, stored["forks"]), sep="\n")
    if options.forks:
        print("", *fork_lines(modules, sources), sep="\n")


if __name__ == "__main__":
    main()
