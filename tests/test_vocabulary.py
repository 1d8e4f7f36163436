"""The field's words: what the project once called by names of its own is not called so again."""

import ast
import re
from pathlib import Path

import pytest
from test_names import messages_of

import jaxshroud

ROOT = Path(jaxshroud.__file__).parents[1]
FIELDS = {  # names of the project's own, as parts of names in the code -> the field's
    "tally": "accumulator",
    "lawbook": "built-in laws",
    "film": "animation",
    "climb": "gradient ascent",
    "absent": "symbolic zero (`Zero`)",
    "formal": "symbolic",
    "look": "styles, appearance",
    "keeping": "export",
    "ahead": "prefetch",
}
OLD_FOLDERS = {"motion", "programs"}


def parts_of(name: str) -> set[str]:
    """The words within a name of Python."""
    return {part.lower() for part in re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])", name)}


def names_defined(tree: ast.Module) -> set[str]:
    """The names of functions, classes and what a module and its classes assign, which others may read."""
    holders = [tree, *(node for node in ast.walk(tree) if isinstance(node, ast.ClassDef))]
    found = {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.ClassDef)}
    for statement in (statement for holder in holders for statement in holder.body):
        targets = statement.targets if isinstance(statement, ast.Assign) else [getattr(statement, "target", None)]
        found |= {target.id for target in targets if isinstance(target, ast.Name)}
    return found


def test_names_are_taken_apart():
    assert parts_of("_updated_RowTally") == {"updated", "row", "tally"}
    assert parts_of("BROKEN_LOOK") == {"broken", "look"}
    assert names_defined(ast.parse("A = 1\ndef f(): b = 2\nclass C:\n    d: int\n")) == {"A", "f", "C", "d"}


def test_names_are_those_of_the_field():
    for path in (ROOT / "jaxshroud").rglob("*.py"):
        defined = names_defined(ast.parse(path.read_text("utf-8")))
        old = {name: [FIELDS[part] for part in parts_of(name) & set(FIELDS)] for name in defined}
        assert not {name: words for name, words in old.items() if words}, path
        assert path.stem not in {"words", *FIELDS}
        assert path.parent.name not in OLD_FOLDERS


def test_pages_name_no_old_module():
    for page in (ROOT / "docs").rglob("*.md"):
        text = page.read_text("utf-8")
        assert not re.findall(rf"\b(?:{'|'.join(OLD_FOLDERS)})/[a-z_]+\.py", text), page
        assert not re.findall(r"\b(?:tally|lawbook|climbs?)\b", text), page


def test_walks_name_files_and_are_short():
    text = (ROOT / "CONTRIBUTING.md").read_text("utf-8")
    walks = text[text.index("## Four walks") :].split("\n## ")[0].split("**From ")[1:]
    for walk in walks:
        files = re.findall(r"^\d+\. `([\w/]+\.\w+)`", walk, re.M)
        assert len(files) <= (8 if walk.startswith("the guard of an event") else 14)
        missing = [f for f in files if not (ROOT / "jaxshroud" / f).exists() and not (ROOT / f).exists()]
        assert not missing
    assert len(walks) == 4


NOT_SAID = {  # by messages and pages -> plain English
    r"\btells?\b(?! apart)": "says, gives, shows",
    r"(?<!cannot be )\btold\b(?! apart)": "given, shown",
    r"\bbut for\b": "except for",
    r"\basked for\b": "requested",
    r"\bone's own\b": "your own",
    r"\bwhat to take\b": "which one to take",
    r"\bnobody knows\b": "it is not known",
    r"\bnever what was meant\b": "not what was meant",
    r"\bnot (?:un|in)\w+ without\b": "one negation",
}
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").rglob("*.md"))]


def found_in(text: str) -> dict[str, list[str]]:
    """What is in a text that is not said, and what is said instead."""
    wrong = [line for line in text.splitlines() if re.search("|".join(NOT_SAID), line, re.IGNORECASE)]
    words = {said: [line for line in wrong if re.search(one, line, re.IGNORECASE)] for one, said in NOT_SAID.items()}
    return {instead: lines for instead, lines in words.items() if lines}


def test_what_is_not_said_is_found():
    assert set(found_in("it Tells all\nbut for one's own")) == {"says, gives, shows", "except for", "your own"}
    assert not found_in("colours that are told apart; 70 cannot be told")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_pages_are_in_plain_english(page):
    prose = re.sub(r"^```.*?^```", "", page.read_text("utf-8"), flags=re.DOTALL | re.MULTILINE)
    assert not found_in(prose)


def test_messages_are_in_plain_english():
    for path in (ROOT / "jaxshroud").rglob("*.py"):
        messages = [text for text in messages_of(ast.parse(path.read_text("utf-8"))) if " " in text]
        assert not found_in("\n".join(messages)), path


def test_docstrings_and_comments_are_in_plain_english():
    for path in (ROOT / "jaxshroud").rglob("*.py"):
        source = path.read_text("utf-8")
        holders = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef
        nodes = [node for node in ast.walk(ast.parse(source)) if isinstance(node, holders)]
        comments = re.findall("#.*", source)
        assert not found_in("\n".join([*filter(None, map(ast.get_docstring, nodes)), *comments])), path
