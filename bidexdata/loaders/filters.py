"""Choose rows: an expression, a dictionary or a function over the scalar columns of the grasps.

Expressions are parsed, never evaluated as Python: names are columns, values are literals, joined
by comparisons, `in`, `and`, `or`, `not`. A null (a test that was not run) satisfies nothing, as in
SQL: neither `suc_l` nor `not suc_l` keeps it.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bidexdata.errors import BadConfig, UnknownName

if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.compute as pc

Where = str | Mapping[str, Any] | Callable[[Mapping[str, np.ndarray]], np.ndarray] | None

DEEPEST = 100
"""Levels of `not`, brackets and comparisons in an expression; Arrow follows them one in another."""
MOST_CONDITIONS = 1000
"""Conditions that an expression joins; some ten times as many were seen to overflow Arrow's stack."""
_SHOWN = 200
"""Letters of an expression that a message repeats."""

_COMPARE: dict[type, Callable[[Any, Any], Any]] = {
    ast.Eq: lambda a, b: a == b,
    ast.NotEq: lambda a, b: a != b,
    ast.Lt: lambda a, b: a < b,
    ast.LtE: lambda a, b: a <= b,
    ast.Gt: lambda a, b: a > b,
    ast.GtE: lambda a, b: a >= b,
}


def matching_rows(where: Where, index: pa.Table) -> NDArray[np.int64]:
    """Row numbers of `index` that satisfy `where`, ascending; all of them for None.

    Args:
        where: For example `"suc_f and size_mm <= 500"`, `{"suc_f": True, "size_mm": [300, 500]}`,
            or a function from a mapping of column arrays to a boolean mask. In the mapping nulls
            of `suc_*` read as False.
        index: Scalar columns, one row per grasp.

    Raises:
        BadConfig: The expression cannot be parsed or the mask has another length.
        UnknownName: A column does not exist.
    """
    if where is None:
        return np.arange(index.num_rows)
    if callable(where):
        columns = {n: scalar_values(index.column(n)) for n in index.schema.names}
        return rows_by_function(where, columns, index.num_rows)
    if isinstance(where, str):
        expression = parse(where, index.schema.names)
    else:
        expression = _by_values(where, index.schema.names)
    return _rows(expression, index)


def rows_by_function(
    where: Callable[[Mapping[str, np.ndarray]], np.ndarray],
    columns: Mapping[str, np.ndarray],
    count: int,
) -> NDArray[np.int64]:
    """Row numbers that a function marks; columns that it does not look at are not read.

    Raises:
        BadConfig: It gives no boolean per row.
        UnknownName: It asks for a column that does not exist.
    """
    try:
        mask = np.asarray(where(columns))
    except KeyError as err:
        if err.args[0] in columns:
            raise
        raise UnknownName("column", str(err.args[0]), list(columns), "in where") from err
    if mask.shape != (count,) or mask.dtype != bool:
        raise BadConfig(
            f"where gave {mask.dtype} {mask.shape}; it must give a boolean per row, ({count},)"
        )
    return np.flatnonzero(mask)


def columns_named(where: Where) -> list[str] | None:
    """Columns that `where` reads; None = any (a function)."""
    if where is None:
        return []
    if callable(where):
        return None
    if isinstance(where, str):
        tree = _tree(where)
        return sorted({n.id for n in ast.walk(tree) if isinstance(n, ast.Name)})
    return list(where)


def parse(text: str, columns: Sequence[str]) -> pc.Expression:
    """Turn an expression into an Arrow expression.

    Raises:
        BadConfig: The text is not such an expression.
        UnknownName: It names a column that does not exist.
    """
    return _expression(_tree(text), text, columns)


def _tree(text: str) -> ast.expr:
    shown = text if len(text) <= _SHOWN else text[:_SHOWN] + "..."
    try:
        tree = ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError) as err:
        raise BadConfig(f"where={shown!r} cannot be read ({err})") from err
    except (RecursionError, MemoryError):  # what Python's parser raises of a deep one
        tree = None
    if tree is None or _too_deep(tree):
        raise BadConfig(
            f"where={shown!r} nests deeper than {DEEPEST} levels, or joins more than "
            f"{MOST_CONDITIONS} conditions; `column in [...]` takes any number of values"
        )
    return tree


def _too_deep(tree: ast.expr) -> bool:
    level: list[ast.AST] = [tree]
    depth = conditions = 0
    while level:
        depth += 1
        for node in level:
            conditions += len(node.values) if isinstance(node, ast.BoolOp) else 0
            conditions += len(node.ops) if isinstance(node, ast.Compare) else 0
        if depth > DEEPEST or conditions > MOST_CONDITIONS:
            return True
        level = [child for node in level for child in ast.iter_child_nodes(node)]
    return False


def _expression(node: ast.expr, text: str, columns: Sequence[str]) -> Any:
    import pyarrow.compute as pc

    match node:
        case ast.Name(id=name):
            if name not in columns:
                raise UnknownName("column", name, columns, f"in where={text!r}")
            return pc.field(name)
        case ast.BoolOp(op=op, values=values):
            parts = [_expression(v, text, columns) for v in values]
            whole = parts[0]
            for part in parts[1:]:
                whole = whole & part if isinstance(op, ast.And) else whole | part
            return whole
        case ast.UnaryOp(op=ast.Not(), operand=operand):
            return ~_expression(operand, text, columns)
        case ast.Compare(left=left, ops=ops, comparators=rights):
            whole, before = None, left
            for op, right in zip(ops, rights, strict=True):
                part = _comparison(before, op, right, text, columns)
                whole = part if whole is None else whole & part
                before = right
            return whole
        case _:
            return _refuse(text, node)


def _comparison(
    left: ast.expr, op: ast.cmpop, right: ast.expr, text: str, columns: Sequence[str]
) -> Any:
    a = _operand(left, text, columns)
    if isinstance(op, (ast.In, ast.NotIn)):
        inside = a.isin(_literals(right, text))
        return inside if isinstance(op, ast.In) else ~inside
    if type(op) not in _COMPARE:
        return _refuse(text, left)
    return _COMPARE[type(op)](a, _operand(right, text, columns))


def _operand(node: ast.expr, text: str, columns: Sequence[str]) -> Any:
    import pyarrow.compute as pc

    if isinstance(node, ast.Name):
        return _expression(node, text, columns)
    return pc.scalar(_literal(node, text))


def _literals(node: ast.expr, text: str) -> list[Any]:
    if not isinstance(node, (ast.List, ast.Tuple, ast.Set)):
        return _refuse(text, node)
    return [_literal(item, text) for item in node.elts]


def _literal(node: ast.expr, text: str) -> Any:
    match node:
        case ast.Constant(value=bool() | int() | float() | str() as value):
            return value
        case ast.UnaryOp(op=ast.USub(), operand=ast.Constant(value=int() | float() as value)):
            return -value
        case _:
            return _refuse(text, node)


def _refuse(text: str, node: ast.AST) -> Any:
    raise BadConfig(
        f"where={text!r}: {ast.unparse(node)!r} is not allowed; compare columns with values, "
        "joined by and, or, not, for example 'suc_f and size_mm <= 500'"
    )


def _by_values(where: Mapping[str, Any], columns: Sequence[str]) -> Any:
    import pyarrow.compute as pc

    whole = pc.scalar(True)
    for name, value in where.items():
        if name not in columns:
            raise UnknownName("column", name, columns, "in where")
        many = isinstance(value, (list, tuple, set, frozenset))
        part = pc.field(name).isin(list(value)) if many else pc.field(name) == value
        whole = whole & part
    return whole


def _rows(expression: Any, index: pa.Table) -> NDArray[np.int64]:
    import pyarrow as pa
    import pyarrow.dataset as ds

    numbered = index.append_column("__row", pa.array(np.arange(index.num_rows)))
    try:
        kept = ds.dataset(numbered).to_table(columns=["__row"], filter=expression)
    except (pa.ArrowException, NotImplementedError, TypeError) as err:
        first = str(err).strip().splitlines()[0]
        raise BadConfig(f"where does not fit the columns' types ({first})") from err
    return np.sort(kept.column("__row").to_numpy())


def scalar_values(column: pa.ChunkedArray) -> np.ndarray:
    """A scalar column as an array; nulls of booleans read as False."""
    import pyarrow as pa

    array = column.combine_chunks()
    if pa.types.is_boolean(array.type):
        array = array.fill_null(False)
    if pa.types.is_string(array.type):
        return np.array(array.to_pylist(), dtype=np.str_)
    return array.to_numpy(zero_copy_only=False)
