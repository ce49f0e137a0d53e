"""Expressions of xacro, evaluated within bounds: of time, of memory, and of what they may call."""

from __future__ import annotations

import ast
import operator
import re
from collections.abc import Callable, ItemsView, Iterator, KeysView, Mapping, ValuesView
from contextlib import contextmanager
from functools import lru_cache, partial, reduce
from pathlib import Path
from string import Formatter
from types import CodeType
from typing import Any, NamedTuple

from pinposture.errors import FileError, PostureError, URDFError


class ExpressionBounds(NamedTuple):
    """What an expression of a description may take."""

    items: int = 100_000
    """Largest value of an expression: its characters and items, those of nested ones included."""

    bits: int = 10_000
    """Largest whole number, in bits; the largest real number has 1,024."""

    characters: int = 10_000
    """Longest expression."""

    yaml: int = 200_000
    """Largest file of YAML [bytes]; larger ones take more than ten seconds to parse."""

    work: int = 20_000_000
    """Most items that all expressions of a file may touch: some ten seconds."""

    step: int = 20
    """Work of a check, or of a round of a comprehension, which takes as long as twenty items."""

    argument: int = 1000
    """Largest number that combinatorial functions take."""


BOUNDS = ExpressionBounds()


_OPERATORS: dict[str, Callable[[Any, Any], Any]] = {
    "Add": operator.add,
    "BitAnd": operator.and_,
    "BitOr": operator.or_,
    "BitXor": operator.xor,
    "Div": operator.truediv,
    "FloorDiv": operator.floordiv,
    "LShift": operator.lshift,
    "MatMult": operator.matmul,
    "Mod": operator.mod,
    "Mult": operator.mul,
    "Pow": operator.pow,
    "RShift": operator.rshift,
    "Sub": operator.sub,
}
_OWNERS = (str, dict, list, tuple, set, frozenset, int, float, complex)
"""Kinds of values whose methods expressions may call."""


class OutOfBounds(PostureError):
    """What an expression would do, and what is allowed."""


class Expressions:
    """Evaluates the expressions of one description, which share their bounds.

    Attributes:
        read: returns the name of the file that is being read, for messages.
        left: work that is left of BOUNDS.work.
    """

    def __init__(self, read: Callable[[], str]) -> None:
        self.read = read
        self.left = BOUNDS.work
        self._guards = (self.operate, self.call, self.attribute, self.checked, self.formatted, self._step)

    def evaluate(self, expression: str, names: dict[str, Any]) -> Any:
        """Return the value of an expression.

        Args:
            expression: in Python, as xacro has it.
            names: what its names mean.

        Raises:
            URDFError: it is too long, takes too long, grows too large, or calls what it may not.
        """
        with self.naming(expression):
            self.spend(BOUNDS.step + len(expression))
            if len(expression) > BOUNDS.characters:
                raise OutOfBounds(f"has {len(expression)} characters; allowed: {BOUNDS.characters}")
            names["__builtins__"] = {}
            return self.checked(eval(_compiled(expression.strip()), names)(*self._guards))

    @contextmanager
    def naming(self, expression: str) -> Iterator[None]:
        """Raise a URDFError that names an expression in place of a OutOfBounds."""
        try:
            yield
        except OutOfBounds as error:
            short = expression if len(expression) < 200 else f"{expression[:197]}..."
            raise URDFError(self.read(), f"expression {short!r}", str(error)) from error

    def spend(self, work: int) -> None:
        """Count work; raise OutOfBounds once there was too much."""
        self.left -= work
        if self.left < 0:
            raise OutOfBounds("takes too long, with those before it; compute less in xacro")

    def checked(self, value: Any) -> Any:
        """Return a value, having counted its items; raise OutOfBounds if there are too many."""
        size = _size(value)
        _require_items(size)
        self.spend(BOUNDS.step + size)
        return value

    def operate(self, symbol: str, left: Any, right: Any) -> Any:
        """Return the result of an operator, having checked how large it will be."""
        bits = [each.bit_length() if isinstance(each, int) else None for each in (left, right)]
        if None not in bits:
            _require_bits(symbol, left, right)
        elif symbol == "Mult":
            sequence, times = (left, right) if bits[0] is None else (right, left)
            if isinstance(times, int) and hasattr(sequence, "__len__"):
                _require_items(_size(sequence) * max(times, 0))
        elif symbol == "Mod" and isinstance(left, (str, bytes)):
            text = left if isinstance(left, str) else left.decode("latin-1")
            for conversion in re.findall(r"%(?:\([^)]*\))?[^a-zA-Z%]*", text):
                _require_narrow(conversion)
                if "*" in conversion:
                    raise OutOfBounds("formats with a width that is computed; write it down")
        return self.checked(_OPERATORS[symbol](left, right))

    def call(self, function: Any, *given: Any, **named: Any) -> Any:
        """Return the result of a call, having counted its arguments."""
        if function is type and len(given) != 1:
            raise OutOfBounds("defines a class")
        values = [self._listed(each) for each in given]
        self.checked([values, named])
        return self.checked(self._listed(function(*values, **named)))

    def attribute(self, value: Any, name: str) -> Any:
        """Return what a dot after a value gives: a member of a namespace or of YAML, or a method."""
        if name.startswith("_"):
            raise OutOfBounds(f"uses .{name}; names with an underscore in front are not allowed")
        if hasattr(value, "top") and isinstance(value, dict):  # a namespace of xacro
            return getattr(value, name) if name in value else _undefined(name)
        if name in ("expandtabs", "format_map", "to_bytes", "translate"):  # results may be of any size
            raise OutOfBounds(f"calls .{name}, which is not allowed")
        if any(value is kind for kind in _OWNERS):
            return lambda each, *given, **named: self.attribute(each, name)(*given, **named)
        if isinstance(value, _OWNERS):
            member = getattr(value, name)
            return partial(self._method, value, name) if callable(member) else member
        raise OutOfBounds(f"uses .{name} of {type(value).__name__}, which is not allowed")

    def formatted(self, value: Any, style: Any, conversion: int) -> str:
        """Return a value as text in the style of a format."""
        _require_narrow(str(style))
        self.checked(value)
        how: dict[int, Callable[[Any], Any]] = {ord("s"): str, ord("r"): repr, ord("a"): ascii}
        return format(how[conversion](value) if conversion in how else value, style)

    def functions(self, given: Mapping[str, Any], namespace: type[dict[str, Any]]) -> dict[str, Any]:
        """Return what expressions of xacro may name, with functions that check their arguments.

        Args:
            given: names and what they mean: functions, numbers, namespaces of these.
            namespace: class of the namespaces.
        """
        checked = [
            "comb",
            "factorial",
            "load_yaml",
            "perm",
            "prod",
            "range",
            "round",
            "sum",
            "tokenize",
            "vars",
        ]
        replaced: dict[str, Any] = {}
        for name, value in given.items():
            if isinstance(value, namespace):
                replaced[name] = namespace()
                dict.update(replaced[name], self.functions(value, namespace))
            else:
                replaced[name] = partial(self._bounded, name, value) if name in checked else value
        return replaced

    def _bounded(self, name: str, function: Callable[..., Any], *given: Any, **named: Any) -> Any:
        arguments = [*given, *named.values()]
        numbers = [abs(each) for each in arguments if isinstance(each, int)]
        if name == "round":
            numbers = numbers[1:]
        if name in ("comb", "factorial", "perm", "round") and max(numbers, default=0) > BOUNDS.argument:
            raise OutOfBounds(f"calls {name} with numbers above {BOUNDS.argument}")
        if name == "sum":
            start = arguments[1] if len(arguments) > 1 else 0
            return reduce(partial(self.operate, "Add"), self._listed(arguments[0]), start)
        if name == "prod":
            start = arguments[1] if len(arguments) > 1 else 1
            return reduce(partial(self.operate, "Mult"), self._listed(arguments[0]), start)
        if name == "vars":
            raise OutOfBounds("calls vars, which is not allowed")
        if name == "tokenize" and any("]" in str(each) for each in arguments[1:]):
            raise OutOfBounds("separates by ']'; allowed: single characters")
        if name == "load_yaml":
            _require_small(*given)
        if name == "range" and max(numbers, default=0) > 2**60:
            raise OutOfBounds("counts beyond 2**60")
        return function(*given, **named)

    def _method(self, value: Any, name: str, *given: Any, **named: Any) -> Any:
        self.checked(value)
        values = [self._listed(each) for each in given]
        if name == "format":
            return _Format(self).vformat(value, values, named)
        if name in ("center", "ljust", "rjust", "zfill"):
            _require_items(values[0])
        if name == "replace":
            _require_items(len(value) + (value.count(values[0]) * len(values[1])))
        if name == "join":
            _require_items(len(value) * len(values[0]) + _size(values[0]))
        if name in ("rfind", "rindex", "rpartition", "rsplit") and values and values[0]:
            self.spend(len(value) * len(values[0]))  # which compare at each index
        return getattr(value, name)(*values, **named)

    def _listed(self, value: Any) -> Any:
        """Return a list of what an iterator gives, and other values as they are."""
        if not hasattr(value, "__next__"):
            return value
        listed = []
        for each in value:
            self.spend(BOUNDS.step)
            listed.append(each)
        return listed

    def _step(self) -> bool:
        self.spend(BOUNDS.step)
        return True


def _size(value: Any) -> int:
    """Return how many characters and items a value has, nested ones included; at least as many as allowed."""
    size = 0
    waiting = [value]
    while waiting and size <= BOUNDS.items:
        each = waiting.pop()
        size += 1
        if isinstance(each, (str, bytes, range)):
            size += _length(each)
        elif isinstance(each, int):
            size += each.bit_length() // 64
        elif isinstance(each, (list, tuple, set, frozenset, KeysView, ValuesView, ItemsView)):
            size += len(each)
            if size <= BOUNDS.items:
                waiting.extend(each)
        elif isinstance(each, dict) and not hasattr(each, "top"):  # which a namespace of xacro has
            size += len(each)
            if size <= BOUNDS.items:
                waiting.extend(each)
                waiting.extend(each.values())
    return size


def _length(value: str | bytes | range) -> int:
    try:
        return len(value)
    except OverflowError:  # of a range
        return BOUNDS.items + 1


def _require_small(name: str) -> None:
    """Raise FileError if a file of YAML, beside the one being read, is a device or too large to parse."""
    from xacro import abs_filename_spec

    path = Path(abs_filename_spec(name))
    if path.exists() and not path.is_file():
        raise FileError(path, "is no file")
    if path.exists() and path.stat().st_size > BOUNDS.yaml:
        raise FileError(path, f"is too large for xacro; allowed: {BOUNDS.yaml} bytes")


def _require_items(size: int) -> None:
    if size > BOUNDS.items:
        raise OutOfBounds(f"makes text or a list of more than {BOUNDS.items} characters and items")


def _require_bits(symbol: str, left: int, right: int) -> None:
    """Raise OutOfBounds if the result of an operator of whole numbers would have too many digits."""
    bits = left.bit_length()
    if symbol == "Pow" and bits > 1:
        bits *= max(right, 1)
    elif symbol == "LShift":
        bits += max(right, 0)
    elif symbol == "Mult":
        bits += right.bit_length()
    if bits > BOUNDS.bits:
        raise OutOfBounds(f"makes a whole number of more than {BOUNDS.bits} bits")


def _require_narrow(style: str) -> None:
    if re.search(r"\d{4}", style):  # widths and precisions of 1,000 and more
        raise OutOfBounds("formats with a width or precision above 999")


def _undefined(name: str) -> Any:
    raise NameError(f"name {name!r} is not defined")


class _Format(Formatter):
    """str.format with the bounds of expressions."""

    def __init__(self, expressions: Expressions) -> None:
        self._expressions = expressions

    def get_field(self, field_name: str, args: Any, kwargs: Any) -> tuple[Any, Any]:
        if "." in field_name:
            raise OutOfBounds("formats an attribute; pass its value")
        found: tuple[Any, Any] = super().get_field(field_name, args, kwargs)
        return found

    def format_field(self, value: Any, format_spec: str) -> Any:
        self._expressions.spend(BOUNDS.step)
        return self._expressions.formatted(value, format_spec, -1)


@lru_cache(maxsize=4096)
def _compiled(expression: str) -> CodeType:
    """Return code of a function of guards (see `Expressions`), with these in place of what is not bounded."""
    tree = ast.parse(expression, "<expression>", "eval")
    # No expression can write such names.
    guards = ("<operate>", "<call>", "<attribute>", "<checked>", "<formatted>", "<step>")
    names = [ast.arg(arg=name) for name in guards]
    arguments = ast.arguments(posonlyargs=[], args=names, kwonlyargs=[], kw_defaults=[], defaults=[])
    guarded = ast.Lambda(args=arguments, body=_Guarded().visit(tree.body))
    whole = ast.fix_missing_locations(ast.Expression(body=guarded))
    return compile(whole, "<expression>", "eval")


class _Guarded(ast.NodeTransformer):
    """Puts guards in place of operators, calls, dots, comparisons, displays and comprehensions."""

    def visit(self, node: ast.AST) -> Any:
        if isinstance(node, (ast.Await, ast.Yield, ast.YieldFrom)):
            raise OutOfBounds("waits or yields, which is not allowed")
        if isinstance(node, (ast.Name, ast.arg)):
            name = node.id if isinstance(node, ast.Name) else node.arg
            if name.startswith("__"):
                raise OutOfBounds(f"uses {name}; names with underscores in front are not allowed")
        return super().visit(node)

    def visit_BinOp(self, node: ast.BinOp) -> ast.expr:
        self.generic_visit(node)
        symbol = ast.Constant(value=type(node.op).__name__)
        return _guard("<operate>", symbol, node.left, node.right)

    def visit_Call(self, node: ast.Call) -> ast.expr:
        self.generic_visit(node)
        call = _guard("<call>", node.func, *node.args)
        call.keywords = node.keywords
        return call

    def visit_Attribute(self, node: ast.Attribute) -> ast.expr:
        self.generic_visit(node)
        return _guard("<attribute>", node.value, ast.Constant(value=node.attr))

    def visit_Compare(self, node: ast.Compare) -> ast.expr:
        self.generic_visit(node)
        node.left = _guard("<checked>", node.left)
        node.comparators = [_guard("<checked>", each) for each in node.comparators]
        return node

    def visit_FormattedValue(self, node: ast.FormattedValue) -> ast.expr:
        self.generic_visit(node)
        style = node.format_spec or ast.Constant(value="")
        node.value = _guard("<formatted>", node.value, style, ast.Constant(value=node.conversion))
        node.format_spec = None
        node.conversion = -1
        return node

    def visit_comprehension(self, node: ast.comprehension) -> ast.comprehension:
        self.generic_visit(node)
        if node.is_async:
            raise OutOfBounds("waits, which is not allowed")
        node.ifs = [_guard("<step>"), *node.ifs]
        return node

    def _visit_whole(self, node: Any) -> Any:
        self.generic_visit(node)
        return _guard("<checked>", node) if isinstance(getattr(node, "ctx", ast.Load()), ast.Load) else node

    visit_Dict = _visit_whole
    visit_DictComp = _visit_whole
    visit_JoinedStr = _visit_whole
    visit_List = _visit_whole
    visit_ListComp = _visit_whole
    visit_Set = _visit_whole
    visit_SetComp = _visit_whole
    visit_Tuple = _visit_whole


def _guard(name: str, *arguments: ast.expr) -> ast.Call:
    return ast.Call(func=ast.Name(id=name, ctx=ast.Load()), args=list(arguments), keywords=[])
