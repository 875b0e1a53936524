"""Products that are added to something, as one instruction.

The physics is written as formulas; `rewritten` changes them, before they are compiled, so that ``a*b + c``
and its like become one fused multiply-add. A compiler that is allowed to fuse chooses differently for one
lane and for eight; rewritten formulas are the same in all, so a drop alone and in lanes ends in the same
bits.
"""

import ast
import inspect
import platform
import textwrap
import types
from collections.abc import Callable
from typing import Any

from numba import types as numba_types
from numba.extending import intrinsic, overload

# Name under which rewritten functions call the fused product.
_NAME = "_fused_multiply_add"


def _has_instruction(context: Any) -> bool:
    """Return whether the CPU that is compiled for has the instruction; a library call takes far longer."""
    _, _, features = context.codegen().magic_tuple()
    return "+fma" in features.split(",") or platform.machine().lower() in ("arm64", "aarch64")


@intrinsic
def fused_multiply_add(typing, a, b, c):
    """a*b + c, rounded once where the CPU can; whole numbers (places of rows) stay whole."""
    whole = all(isinstance(kind, numba_types.Integer) for kind in (a, b, c))
    kind = numba_types.intp if whole else numba_types.float64

    def generate(context, builder, signature, arguments):
        x, y, z = arguments
        if whole:
            return builder.add(builder.mul(x, y), z)
        if _has_instruction(context):
            return builder.fma(x, y, z)
        return builder.fadd(builder.fmul(x, y), z)

    return kind(kind, kind, kind), generate


def _chosen(typing, condition, a, b):
    """`a` where a condition holds, else `b`: both are read, so that a choice between rows is packed.

    Of ``a if condition else b`` the compiler makes a choice between two addresses, which it cannot pack.
    """

    def generate(context, builder, signature, arguments):
        return builder.select(*arguments)

    return numba_types.float64(numba_types.boolean, numba_types.float64, numba_types.float64), generate


chosen: Any = intrinsic(_chosen)


@intrinsic
def whole_vectors(typing):
    """Let the function that calls this compute in vectors of 512 bits where the CPU has them.

    For Intel's CPUs the compiler prefers halves of them.
    """

    def generate(context, builder, signature, arguments):
        # `add` would refuse an attribute that has a value.
        builder.function.attributes.update(['"prefer-vector-width"="512"'])
        return context.get_dummy_value()

    return numba_types.void(), generate


class _Fusing(ast.NodeTransformer):
    def visit_BinOp(self, node: ast.BinOp) -> ast.expr:
        left, right = self.visit(node.left), self.visit(node.right)
        if isinstance(node.op, ast.Add) and not (_product(left) and _product(right)):
            if _product(left):
                return _call(node, left.left, left.right, right)
            if _product(right):
                return _call(node, right.left, right.right, left)
        elif isinstance(node.op, ast.Sub):
            if _product(right):
                return _call(node, _negative(right.left), right.right, left)
            if _product(left):
                return _call(node, left.left, left.right, _negative(right))
        return ast.copy_location(ast.BinOp(left, node.op, right), node)

    def visit_AugAssign(self, node: ast.AugAssign) -> ast.stmt:
        value = self.visit(node.value)
        if isinstance(node.op, ast.Add) and isinstance(node.target, ast.Name) and _product(value):
            target = ast.copy_location(ast.Name(node.target.id, ast.Load()), node)
            sum_ = _call(node, value.left, value.right, target)
            return ast.copy_location(ast.Assign([node.target], sum_), node)
        return ast.copy_location(ast.AugAssign(node.target, node.op, value), node)


def _product(node: ast.expr) -> bool:
    return isinstance(node, ast.BinOp) and isinstance(node.op, ast.Mult)


def _negative(node: ast.expr) -> ast.expr:
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        return node.operand
    return ast.copy_location(ast.UnaryOp(ast.USub(), node), node)


def _call(place: ast.AST, *arguments: ast.expr) -> ast.expr:
    function = ast.copy_location(ast.Name(_NAME, ast.Load()), place)
    return ast.copy_location(ast.Call(function, list(arguments), []), place)


# Options of a function that only compiled functions call. Its wrapper for Python would take as long to
# compile as the function itself.
INSIDE: dict[str, Any] = {"error_model": "numpy", "no_cpython_wrapper": True, "no_cfunc_wrapper": True}


def part(function: Callable[..., object]) -> Any:
    """Let compiled functions call a function; for Python it stays as it is."""
    return _inside(function, function, INSIDE)


def fused(function: Callable[..., object]) -> Any:
    """Inline a function in compiled ones, `rewritten`; for Python it stays as it is."""
    return _inside(function, rewritten(function), {**INSIDE, "forceinline": True})


def _inside(function: Any, compiled: object, options: Any) -> Any:
    # `prefer_literal` lets the compiler unroll loops over the stages of a step.
    overload(function, options, strict=False, prefer_literal=True)(lambda *arguments: compiled)
    return function


def rewritten(function: Callable[..., object]) -> types.FunctionType:
    """Return a function, to be compiled, with every product that is added to something fused into the sum.

    A sum of two products is left: with one of them rounded and the other not, what the rear and the front leg
    of a level drone do would no longer cancel. In a difference of two products the second is fused. The
    function stands in a file and has no closure.
    """
    lines, first = inspect.getsourcelines(function)
    tree = ast.parse(textwrap.dedent("".join(lines)))
    (definition,) = tree.body
    assert isinstance(definition, ast.FunctionDef)
    definition.decorator_list = []
    fitted = ast.fix_missing_locations(_Fusing().visit(tree))
    ast.increment_lineno(fitted, first - 1)
    module = compile(fitted, inspect.getfile(function), "exec")
    (code,) = [constant for constant in module.co_consts if isinstance(constant, types.CodeType)]
    function.__globals__[_NAME] = fused_multiply_add
    out = types.FunctionType(code, function.__globals__, function.__name__, function.__defaults__)
    for name in ("__doc__", "__qualname__", "__module__"):
        setattr(out, name, getattr(function, name))
    return out
