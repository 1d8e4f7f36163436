"""Where the package forks on row or pair, found in the syntax of its modules.

A fork is a test (`if`, `while`, `assert`, a condition, a filter, an operand of `and` and `or`, a `case`), or a choice
by an index, a mapping, arithmetic with a boolean or `where`, that hangs on a row, a layout, a closed row, the number of
blades or interfaces, the rank of arrays of contact, or a class of rows. A test that names several of these is one fork.

What a test hangs on is told by names (those below) and by what names are bound to: a name that is bound to such a test
is one of its own, as is a parameter that is given nothing else in any call, a property, or a function that returns one.
"""

import ast
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from typing import NamedTuple

SIZES = {"row", "row_size", "layout", "peak_blades", "P_d_stiffness"}  # None for a pair, or for a row
FLAGS = {"in_row", "is_row", "of_row", "has_row", "is_of_row", "whole_row", "row_of_blades", "one_row", "is_pair"}
PARAMETERS = FLAGS | {"paired", "closed", "is_closed", "ring"}  # booleans where they are parameters
COUNTS = {"blades", "n_blades", "blade_count", "number_of_blades", "interfaces", "n_interfaces"}
MOTIONS = {"motion", "means"}  # a tuple of numbers in pairs, arrays in rows
ARRAYS = MOTIONS | {"gap", "gaps", "k", "mu", "u_s", "mode", "case", "slider", "sliders", "contact", "friction"}
WORDS = {"row", "in_row", "closed", "layout"}  # keys of mappings
TOLD_BY = WORDS | {"\n[row]", "P_d_worst"}  # what is in a scene, as TOML, or in a result, if they are of a row
KINDS = {"row", "pair", "ring", "chain"}  # words that `kind` or `layout` is compared with
ROW_CLASS = re.compile(r"_?(Row|Pair)(?=[A-Z]|$)")
ROW_TYPE = re.compile(r"\b(RowSize|RowTable|Row|Layout)\b")  # of annotations
MOST_COUNTED = 3  # blades or interfaces that a number of them is compared with, to tell a pair from a row
MOST_PASSES = 6  # until what names in one module are bound to is known in all others

# What an expression is: `SIZE` and `FLAG` are forks where they are tested, the others where they are compared.
SIZE, FLAG, COUNT, RANK, ARRAY, CHOSEN = "size", "flag", "count", "rank", "array", "chosen"
TESTED = {SIZE, FLAG, RANK}
PASSED = {SIZE, FLAG, CHOSEN}  # what makes a parameter the same
Function = ast.FunctionDef | ast.AsyncFunctionDef
Comprehension = ast.ListComp | ast.SetComp | ast.DictComp | ast.GeneratorExp
Scoped = ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda | ast.ClassDef | Comprehension
# For `isinstance`, in which unions are slow.
FUNCTIONS, COMPREHENSIONS, SCOPED = Function.__args__, Comprehension.__args__, Scoped.__args__
ASSIGNMENTS, TESTS = (ast.Assign, ast.AnnAssign, ast.NamedExpr), (ast.If, ast.While, ast.IfExp, ast.Assert)
BITWISE, SUMS = (ast.BitAnd, ast.BitOr), (ast.Add, ast.Sub)
ONLY_TESTS = {"bool", "any", "all", "where", "select", "cond", "get"}  # functions whose arguments are tested
WHOLE = (*SCOPED, ast.IfExp)  # whose tests are forks of their own


class Fork(NamedTuple):
    """A place where the code goes one way for a row and another for a pair."""

    line: int
    column: int


class Known:
    """What is known of the whole package: functions, properties and parameters that are forks by another name."""

    def __init__(self, definitions: Mapping[str, list[Function | ast.ClassDef]], before: "Known | None") -> None:
        self.definitions, self.before = definitions, before  # what was known before this pass
        # By "returns", "property" or the name of a function, and a name: all that it is found to be.
        self.told: dict[tuple[str, str], set[str | None]] = defaultdict(set)

    def kind(self, of: str, name: str) -> str | None:
        """What a function returns, a property is or a parameter is given, if it is the same everywhere."""
        kinds = self.before.told.get((of, name), set()) if self.before else set()
        return next(iter(kinds)) if len(kinds) == 1 else None


class Scope:
    """The names that a module, a function or a comprehension binds, and what they are."""

    def __init__(self, parent: "Scope | None" = None) -> None:
        self.parent, self.names = parent, {}

    def bind(self, name: str, kind: str | None) -> None:
        """Bind a name; what it was bound to before counts too."""
        self.names[name] = self.names.get(name) or kind

    def kind(self, name: str) -> str | None:
        """What a name is; if nothing in sight binds it, its name tells."""
        if name in self.names:
            return self.names[name]
        return self.parent.kind(name) if self.parent else by_name(name)


def last_name(node: ast.AST) -> str:
    """The last part of a name, without underscores in front: of `scene.row` it is "row"; '' of other expressions."""
    if isinstance(node, ast.Call):
        return last_name(node.func)
    return (getattr(node, "attr", None) or getattr(node, "id", "")).lstrip("_")


def called(node: ast.Call) -> str:
    """The name of the function that is called."""
    return getattr(node.func, "attr", getattr(node.func, "id", ""))


def is_word(node: ast.AST, words: Iterable[object]) -> bool:
    """Whether an expression is one of these constants."""
    return isinstance(node, ast.Constant) and isinstance(node.value, str) and node.value in words


def is_empty(node: ast.AST) -> bool:
    """Whether an expression is None or something else without a content."""
    if isinstance(node, ast.Constant):
        return not node.value
    return isinstance(node, ast.List | ast.Tuple | ast.Dict) and not ast.unparse(node).strip("[](){}")


def has_row_class(node: ast.AST | None) -> bool:
    """Whether an expression names a class of rows or of pairs, and not with `RowChoice` its other side, `Choice`."""
    names = {getattr(n, "attr", getattr(n, "id", "")) for n in (ast.walk(node) if node else ())}
    return any(ROW_CLASS.match(name) and ROW_CLASS.sub("", name) not in names for name in names)


def by_name(name: str) -> str | None:
    """What a name says of itself; `row` may be one of a table, and says nothing."""
    for kind, names in ((FLAG, FLAGS), (SIZE, SIZES - {"row"}), (COUNT, COUNTS), (ARRAY, ARRAYS)):
        if name in names:
            return kind
    return None


def is_kind(node: ast.AST) -> bool:
    """Whether an expression is the word for a kind of result or a layout."""
    keys = node.args if isinstance(node, ast.Call) else [node.slice] if isinstance(node, ast.Subscript) else []
    return last_name(node) in ("kind", "layout") or any(is_word(key, {"kind"}) for key in keys)


def by_annotation(name: str, annotation: ast.AST | None) -> str | None:
    """What a parameter is by its name and its annotation."""
    told, name = "" if annotation is None else ast.unparse(annotation).strip("'\""), name.lstrip("_")
    if ROW_TYPE.search(told):
        return SIZE
    if name in SIZES:
        return SIZE if not told or told == "Any" or "None" in told else None
    if name in PARAMETERS and told in ("", "Any", "bool", "bool | None"):
        return FLAG
    if name == "rows" and told == "bool":
        return FLAG
    return by_name(name) if name in COUNTS | ARRAYS else None


class Module:
    """The forks of one module."""

    def __init__(self, tree: ast.Module, known: Known) -> None:
        self.known, self.forks, self.seen = known, set(), set()
        self.passed = 0  # forks that are arguments, and are tested elsewhere
        self.switches = {  # attributes that are set to True or False: states of an object, not of its scene
            target.attr
            for node in within(tree)
            if isinstance(node, ast.Assign)
            for targets, value in [(node.targets, node.value)]
            for target, given in paired_with(targets, value)
            if isinstance(target, ast.Attribute) and isinstance(given, ast.Constant) and isinstance(given.value, bool)
        }
        self.own: dict[str, str] = {}  # attributes of `self` that are set to a fork
        self.tables = {  # mappings that a class of rows is a key of
            target.id
            for node in tree.body
            if isinstance(node, ast.Assign | ast.AnnAssign) and isinstance(node.value, ast.Dict)
            for target in ([node.target] if isinstance(node, ast.AnnAssign) else node.targets)
            if isinstance(target, ast.Name) and any(map(has_row_class, node.value.keys))
        }
        scope = Scope()
        self.bind(tree.body, scope)
        for statement in tree.body:
            self.visit(statement, scope)

    # What an expression is

    def kind(self, node: ast.AST, scope: Scope) -> str | None:
        """What an expression is."""
        find = getattr(self, f"kind_of_{type(node).__name__}", None)
        return find(node, scope) if find else None

    def forks_on(self, node: ast.AST, scope: Scope) -> bool:
        """Whether a test of an expression is a fork."""
        return self.kind(node, scope) in TESTED

    def kind_of_Name(self, node: ast.Name, scope: Scope) -> str | None:
        """What a name is bound to."""
        return scope.kind(node.id)

    def kind_of_NamedExpr(self, node: ast.NamedExpr, scope: Scope) -> str | None:
        """What is bound."""
        return self.kind(node.value, scope)

    def kind_of_Attribute(self, node: ast.Attribute, scope: Scope) -> str | None:
        """What an attribute is by its name."""
        name, of_self = node.attr.lstrip("_"), isinstance(node.value, ast.Name) and node.value.id == "self"
        if of_self and node.attr in self.own:
            return self.own[node.attr]
        if name == "ndim":
            return RANK if self.is_array(node.value, scope) else None
        if name in ("closed", "is_closed"):
            return None if of_self and node.attr in self.switches else FLAG
        if name in SIZES or name in FLAGS:
            return SIZE if name in SIZES else FLAG
        if name == "rows" and isinstance(node.value, ast.Subscript) and last_name(node.value.value).isupper():
            return FLAG  # COMMANDS[verb].rows: whether a command knows rows
        return COUNT if name in COUNTS else self.known.kind("property", node.attr)

    def is_array(self, node: ast.AST, scope: Scope) -> bool:
        """Whether an expression is an array of contact, or a number of a motion."""
        if isinstance(node, ast.Attribute):
            return node.attr.lstrip("_") in ARRAYS or last_name(node.value) in MOTIONS
        return self.kind(node, scope) == ARRAY

    def kind_of_Subscript(self, node: ast.Subscript, scope: Scope) -> str | None:
        """What an entry of a mapping is by its key."""
        return self.by_key(node.slice)

    def by_key(self, key: ast.AST) -> str | None:
        """What an entry of a mapping is."""
        if not is_word(key, WORDS):
            return None
        return SIZE if key.value in SIZES else FLAG

    def kind_of_Call(self, node: ast.Call, scope: Scope) -> str | None:
        """What a function returns."""
        name, first = last_name(node.func), node.args[0] if node.args else None
        if name in ("isinstance", "issubclass") and len(node.args) == 2:
            return FLAG if self.is_class_test(*node.args, scope) else None
        if name == "hasattr" and len(node.args) == 2:
            return FLAG if is_word(node.args[1], WORDS) else None
        if name in ("get", "getattr", "pop") and node.args:
            return self.by_key(node.args[min(name == "getattr", len(node.args) - 1)])
        if first is not None and name in ("bool", "any", "all", "ndim", "len"):
            return self.of_first(name, first, scope)
        return COUNT if name == "blade_count" else self.known.kind("returns", called(node))

    def of_first(self, name: str, first: ast.AST, scope: Scope) -> str | None:
        """What functions of one argument return."""
        if name == "len":
            return COUNT if last_name(first) in COUNTS else None
        if name == "ndim":
            return RANK if self.is_array(first, scope) else None
        if isinstance(first, COMPREHENSIONS) and not isinstance(first, ast.DictComp):
            return FLAG if self.forks_on(first.elt, self.inner(first, scope)) else None
        parts = first.elts if isinstance(first, ast.List | ast.Tuple) else [first]
        return FLAG if any(self.forks_on(part, scope) for part in parts) else None

    def is_class_test(self, tested: ast.AST, classes: ast.AST, scope: Scope) -> bool:
        """Whether a test of a class tells rows from pairs; motions are tuples in pairs, and arrays in rows."""
        by_tuple = isinstance(classes, ast.Name) and classes.id == "tuple"
        of_motion = isinstance(tested, ast.Attribute) and last_name(tested.value) in MOTIONS
        return has_row_class(classes) or (by_tuple and (of_motion or self.kind(tested, scope) == ARRAY))

    def kind_of_UnaryOp(self, node: ast.UnaryOp, scope: Scope) -> str | None:
        """The opposite of a fork is one."""
        return FLAG if isinstance(node.op, ast.Not | ast.Invert) and self.forks_on(node.operand, scope) else None

    def kind_of_BoolOp(self, node: ast.BoolOp, scope: Scope) -> str | None:
        """What has a fork as an operand is one."""
        return FLAG if any(self.forks_on(value, scope) for value in node.values) else None

    def kind_of_BinOp(self, node: ast.BinOp, scope: Scope) -> str | None:
        """Numbers of blades and ranks, plus or minus something, are such; conditions of arrays may be forks."""
        kinds = {self.kind(node.left, scope), self.kind(node.right, scope)}
        if isinstance(node.op, BITWISE):
            return FLAG if FLAG in kinds else None
        if isinstance(node.op, SUMS):
            return RANK if RANK in kinds else COUNT if COUNT in kinds else None
        return None

    def kind_of_IfExp(self, node: ast.IfExp, scope: Scope) -> str | None:
        """What is chosen by a fork, and empty for one side of it, is a fork when it is tested."""
        for part in (node.body, node.orelse):
            if (kind := self.kind(part, scope)) in (SIZE, FLAG, CHOSEN):
                return kind
        if not self.forks_on(node.test, scope):
            return None
        return SIZE if is_empty(node.body) != is_empty(node.orelse) else CHOSEN

    def kind_of_Compare(self, node: ast.Compare, scope: Scope) -> str | None:
        """A comparison is a fork if one of its pairs is."""
        operands = [node.left, *node.comparators]
        pairs = zip(operands, node.ops, operands[1:], strict=False)
        return FLAG if any(self.compares(a, op, b, scope) for a, op, b in pairs) else None

    def compares(self, a: ast.AST, op: ast.cmpop, b: ast.AST, scope: Scope) -> bool:
        """Whether a comparison of two tells rows from pairs."""
        if isinstance(op, ast.In | ast.NotIn):
            return (is_word(a, TOLD_BY) and not isinstance(b, ast.Tuple)) or self.is_told_by(a, op, b, scope)
        return self.is_told_by(a, op, b, scope) or self.is_told_by(b, op, a, scope)

    def is_told_by(self, a: ast.AST, op: ast.cmpop, b: ast.AST, scope: Scope) -> bool:
        """Whether it is the first of two that a comparison tells rows from pairs by."""
        kind = self.kind(a, scope)
        if kind in (FLAG, RANK):
            return True
        if kind == SIZE:
            return isinstance(op, ast.Is | ast.IsNot | ast.Eq | ast.NotEq | ast.In | ast.NotIn)
        if kind == COUNT:
            return isinstance(b, ast.Constant) and type(b.value) is int and 0 < b.value <= MOST_COUNTED
        if kind == CHOSEN:
            return isinstance(op, ast.Is | ast.IsNot) and not isinstance(b, ast.Constant)
        if isinstance(a, ast.Tuple):
            return any(self.is_told_by(part, op, b, scope) for part in a.elts)
        if is_kind(a):
            return is_word(b, KINDS)
        return last_name(a) in ("type", "class__") and has_row_class(b)

    # What names are bound to

    def bind(self, body: Iterable[ast.AST], scope: Scope) -> None:
        """Bind the names that statements of one scope bind."""
        for node in (inner for statement in body for inner in within_scope(statement)):
            if isinstance(node, ASSIGNMENTS) and node.value is not None:
                targets = node.targets if isinstance(node, ast.Assign) else [node.target]
                for target, value in paired_with(targets, node.value):
                    self.bind_target(target, self.bound(value, scope), scope)
            elif isinstance(node, ast.For | ast.AsyncFor):
                self.bind_loop(node.target, node.iter, scope)
            elif isinstance(node, ast.withitem) and node.optional_vars is not None:
                self.bind_target(node.optional_vars, None, scope)

    def bound(self, value: ast.AST, scope: Scope) -> str | None:
        """What a name is that a value is bound to: `choice or choice_of_row` has a content for rows and for pairs."""
        if isinstance(value, ast.BoolOp) and isinstance(value.op, ast.Or):
            return FLAG if FLAG in {self.kind(part, scope) for part in value.values} else None
        return self.kind(value, scope)

    def bind_target(self, target: ast.AST, kind: str | None, scope: Scope) -> None:
        """Bind all names of the target of an assignment."""
        if isinstance(target, ast.Name):
            scope.bind(target.id, kind or by_name(target.id))
        elif isinstance(target, ast.Attribute) and kind in (SIZE, FLAG):
            self.own[target.attr] = kind
        for part in target.elts if isinstance(target, ast.Tuple | ast.List) else ():
            self.bind_target(part, None, scope)

    def bind_loop(self, target: ast.AST, over: ast.AST, scope: Scope) -> None:
        """Bind the names of a loop; those that run over the numbers of a motion are arrays."""
        names = {n.id for n in ast.walk(target) if isinstance(n, ast.Name)}
        for name in names:
            scope.names[name] = ARRAY if last_name(over) in MOTIONS else None

    def inner(self, node: Scoped, scope: Scope) -> Scope:
        """The scope of a function, a class or a comprehension."""
        inner = Scope(scope)
        if isinstance(node, COMPREHENSIONS):
            for generator in node.generators:
                self.bind_loop(generator.target, generator.iter, inner)
            return inner
        if not isinstance(node, ast.ClassDef):
            self.bind_parameters(node, inner)
        self.bind([node.body] if isinstance(node, ast.Lambda) else node.body, inner)
        return inner

    def bind_parameters(self, node: Function | ast.Lambda, scope: Scope) -> None:
        """Bind the parameters of a function."""
        given, function = node.args, getattr(node, "name", "")
        for argument in [*given.posonlyargs, *given.args, *given.kwonlyargs]:
            told = by_annotation(argument.arg, argument.annotation)
            scope.bind(argument.arg, told or self.known.kind(function, argument.arg))

    # Where forks are

    def visit(self, node: ast.AST, scope: Scope) -> None:
        """Note the forks of a node and of all within it."""
        if id(node) not in self.seen:
            for test in self.tests(node, scope):
                self.note(test)
        if isinstance(node, ast.Call):
            self.learn_call(node, scope)
        if isinstance(node, SCOPED):
            inner = self.inner(node, scope)
            if isinstance(node, FUNCTIONS):
                self.learn_function(node, inner)
            scope = inner
        for child in children(node):
            self.visit(child, scope)

    def note(self, test: ast.AST) -> None:
        """Note a fork; what it consists of is no other."""
        self.forks.add(Fork(test.lineno, test.col_offset))
        nodes = [test]
        while nodes:
            node = nodes.pop()
            self.seen.add(id(node))
            nodes += () if isinstance(node, WHOLE) and node is not test else children(node)

    def tests(self, node: ast.AST, scope: Scope) -> Iterator[ast.AST]:
        """The forks that a node itself is."""
        if isinstance(node, TESTS):
            if self.forks_on(node.test, scope):
                yield node.test
        elif isinstance(node, ast.BoolOp):
            if self.forks_on(node, scope):
                yield node
        elif isinstance(node, COMPREHENSIONS):
            inner = self.inner(node, scope)
            yield from (test for part in node.generators for test in part.ifs if self.forks_on(test, inner))
        elif isinstance(node, ast.Match):
            yield from self.cases(node, scope)
        elif self.is_dispatch(node, scope):
            yield node

    def cases(self, node: ast.Match, scope: Scope) -> Iterator[ast.AST]:
        """A subject that tells rows from pairs, or else the cases that do, and their guards."""
        by_subject = self.kind(node.subject, scope) in TESTED | {COUNT}
        if by_subject:
            yield node.subject
        for case in node.cases:
            classes = [part.cls for part in ast.walk(case.pattern) if isinstance(part, ast.MatchClass)]
            if not by_subject and any(map(has_row_class, classes)):
                yield case.pattern
            elif case.guard is not None and self.forks_on(case.guard, scope):
                yield case.guard

    def is_dispatch(self, node: ast.AST, scope: Scope) -> bool:
        """Whether a node chooses by an index, a mapping, arithmetic, `where`, or by registered classes."""
        if isinstance(node, ast.Subscript):
            return self.is_chosen(node.value, node.slice, scope)
        if isinstance(node, ast.BinOp):
            return not isinstance(node.op, BITWISE) and FLAG in self.operands(node, scope)
        if isinstance(node, FUNCTIONS):
            return any(last_name(d) == "register" for d in node.decorator_list) and self.is_for_rows(node)
        if not isinstance(node, ast.Call) or not node.args:
            return False
        name, first = last_name(node.func), node.args[0]
        if name == "get" and isinstance(node.func, ast.Attribute):
            return self.is_chosen(node.func.value, first, scope)
        if name in ("where", "select", "select_n", "select_tree", "cond"):
            return self.forks_on(first, scope)
        return name == "register" and len(node.args) > 1 and has_row_class(first)

    def is_chosen(self, table: ast.AST, index: ast.AST, scope: Scope) -> bool:
        """Whether an entry is chosen by row or pair, by the number of blades, or by the class of a result."""
        parts = index.elts if isinstance(index, ast.Tuple) else [index]
        ends = [e for part in parts if isinstance(part, ast.Slice) for e in (part.lower, part.upper) if e]
        kinds = {self.kind(part, scope) for part in [*parts, *ends]}
        is_table = isinstance(table, ast.Dict) or last_name(table).isupper()
        if kinds & {FLAG, RANK} or (is_table and kinds & {SIZE, COUNT}):
            return True
        of_rows = last_name(table) in self.tables or (
            isinstance(table, ast.Dict) and any(map(has_row_class, table.keys))
        )
        return of_rows and last_name(index) in ("type", "class__")

    def operands(self, node: ast.BinOp, scope: Scope) -> set[str | None]:
        """What the operands of arithmetic are, those of its parts too."""
        sides = (node.left, node.right)
        return {
            kind
            for side in sides
            for kind in [self.kind(side, scope), *(self.operands(side, scope) if isinstance(side, ast.BinOp) else ())]
        }

    def is_for_rows(self, node: Function) -> bool:
        """Whether a function is registered for a class of rows."""
        given = [a for d in node.decorator_list if isinstance(d, ast.Call) for a in d.args]
        annotated = [a.annotation for a in node.args.args[:2]]
        return any(map(has_row_class, [*given, *annotated]))

    # What other modules are told

    def learn_function(self, node: Function, scope: Scope) -> None:
        """Tell what a function returns."""
        returns = [n.value for s in node.body for n in within_scope(s) if isinstance(n, ast.Return)]
        kinds = {self.kind(value, scope) if value is not None else None for value in returns}
        kind = kinds.pop() if len(kinds) == 1 and not kinds - {SIZE, FLAG} else None
        if node.returns is not None and re.search(rf"{ROW_TYPE.pattern} \| None", ast.unparse(node.returns)):
            kind = SIZE
        is_property = any(last_name(d) in ("property", "cached_property") for d in node.decorator_list)
        self.known.told["property" if is_property else "returns", node.name].add(kind)

    def learn_call(self, node: ast.Call, scope: Scope) -> None:
        """Tell what a call passes to the parameters of a function that has its name for itself."""
        values = [*node.args, *(word.value for word in node.keywords)]
        self.passed += called(node) not in ONLY_TESTS and any(self.kind(value, scope) == FLAG for value in values)
        definitions = self.known.definitions.get(called(node), [])
        function = constructor(definitions[0]) if len(definitions) == 1 else None
        if function is None:
            return
        names = [a.arg for a in [*function.args.posonlyargs, *function.args.args] if a.arg not in ("self", "cls")]
        given = [*zip(names, node.args, strict=False), *((word.arg, word.value) for word in node.keywords if word.arg)]
        for name, value in given:
            is_switch = isinstance(value, ast.Constant) and isinstance(value.value, bool)
            if not is_switch and not isinstance(value, ast.Starred):
                kind = self.kind(value, scope)
                self.known.told[function.name, name].add(kind if kind in PASSED else None)


def constructor(node: Function | ast.ClassDef) -> Function | None:
    """The function that is called: of a class its `__init__`, if it has one."""
    if isinstance(node, FUNCTIONS):
        return node
    return next((f for f in node.body if isinstance(f, ast.FunctionDef) and f.name == "__init__"), None)


def children(node: ast.AST) -> list[ast.AST]:
    """The nodes right within a node, without operators and the like; kept, for they are gone through often."""
    if not hasattr(node, "inside"):
        node.inside = [child for child in ast.iter_child_nodes(node) if child._fields]
    return node.inside


def within(node: ast.AST) -> Iterator[ast.AST]:
    """A node and all within it."""
    nodes = [node]
    while nodes:
        nodes += children(node := nodes.pop())
        yield node


def within_scope(node: ast.AST) -> Iterator[ast.AST]:
    """A node and all within it, without the insides of functions and classes, in the order of the source."""
    yield node
    if not isinstance(node, SCOPED):
        for child in children(node):
            yield from within_scope(child)


def paired_with(targets: Iterable[ast.AST], value: ast.AST) -> Iterator[tuple[ast.AST, ast.AST]]:
    """Targets and what each is assigned; tuples are taken apart."""
    for target in targets:
        if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple) and len(target.elts) == len(value.elts):
            for one, given in zip(target.elts, value.elts, strict=True):
                yield from paired_with([one], given)
        else:
            yield target, value


def definitions_of(trees: Iterable[ast.Module]) -> dict[str, list[Function | ast.ClassDef]]:
    """The functions and classes of all modules by their names."""
    found = defaultdict(list)
    for node in (node for tree in trees for node in within(tree)):
        if isinstance(node, (*FUNCTIONS, ast.ClassDef)):
            found[node.name].append(node)
    return found


def modules_of(sources: Mapping[str, str]) -> dict[str, Module]:
    """What is found in modules (path -> source): gone through until what they tell each other changes no more."""
    trees = {path: ast.parse(source) for path, source in sources.items()}
    definitions = definitions_of(trees.values())
    known = Known(definitions, None)
    for _ in range(MOST_PASSES):
        before, known = known, Known(definitions, known)
        found = {path: Module(tree, known) for path, tree in trees.items()}
        before.before = None
        if known.told == before.told:
            break
    return found
