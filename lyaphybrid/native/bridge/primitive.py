"""Native code within JAX: a primitive that calls a program.

Called eagerly it is a ctypes call, which releases Python's lock. Under jit on a CPU it is a call through XLA's foreign
function interface; on other platforms, and for `jax.export`, XLA compiles the jaxpr itself. Its derivative is a native
call of the program of the tangents. Under vmap one call computes the lanes one after the other, so that a branch is
computed only where it is taken.
"""

from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
from jax.extend.core import Primitive, jaxpr_as_fun
from jax.interpreters import ad, batching, mlir

from .placing import on_device
from .programs import Program, inexact

native_call = Primitive("native_call")
native_call.multiple_results = True


@native_call.def_impl
def _call(*operands, program: Program):
    return on_device(program(*operands))


@native_call.def_abstract_eval
def _abstract(*operands, program: Program):
    del operands
    return program.out_avals


_by_xla = mlir.lower_fun(lambda *xs, program: jaxpr_as_fun(program.closed)(*xs), multiple_results=True)


def _on_cpu(context, *operands, program: Program):
    exported = getattr(context.module_context.lowering_parameters, "for_export", False)
    if exported or program.target is None:
        return _by_xla(context, *operands, program=program)
    return jax.ffi.ffi_lowering(program.target)(context, *operands)


mlir.register_lowering(native_call, _by_xla)
mlir.register_lowering(native_call, _on_cpu, platform="cpu")


def _jvp(primals, tangents, *, program: Program):
    moving = tuple(type(tangent) is not ad.Zero for tangent in tangents)
    # The values have a call of their own: under jacfwd only the tangents are batched.
    results = native_call.bind(*primals, program=program)
    changes = [ad.instantiate_zeros(t) for t, moves in zip(tangents, moving, strict=True) if moves]
    found = iter(native_call.bind(*primals, *changes, program=program.pushed(moving)))
    out = [next(found) if inexact(aval) else ad.Zero(aval.to_tangent_aval()) for aval in program.closed.out_avals]
    return results, out


ad.primitive_jvps[native_call] = _jvp


def _transpose(cotangents, *operands, program: Program):
    if program.origin is None:
        raise NotImplementedError("only the program of a derivative is linear in its operands")
    of, moving = program.origin
    fixed = operands[: len(moving)]
    asked = tuple(type(x) is not ad.Zero for x in cotangents)
    given = [x for x, wants in zip(cotangents, asked, strict=True) if wants]
    return [None] * len(fixed) + list(native_call.bind(*fixed, *given, program=of.pulled(moving, asked)))


ad.primitive_transposes[native_call] = _transpose


def _batch(operands: Sequence, axes: Sequence, *, program: Program):
    which = tuple(axis is not None for axis in axes)
    (size,) = {x.shape[axis] for x, axis in zip(operands, axes, strict=True) if axis is not None}
    moved = [jnp.moveaxis(x, axis, 0) if w else x for x, axis, w in zip(operands, axes, which, strict=True)]
    return native_call.bind(*moved, program=program.mapped(which, size)), [0] * len(program.closed.out_avals)


batching.primitive_batchers[native_call] = _batch


def native(function: Callable, columns: int | None = None) -> Callable:
    """A function of pytrees of arrays as native code, eagerly and under jit, vmap and jvp.

    It is traced once for each structure, shape and type of its arguments. It must not close over traced values.
    """
    known: dict = {}

    def call(*args):
        leaves, tree = jax.tree.flatten(args)
        leaves = [x if hasattr(x, "shape") else jnp.asarray(x) for x in leaves]
        key = tree, tuple((x.shape, x.dtype) for x in leaves)
        if key not in known:
            structs = jax.tree.unflatten(tree, [jax.ShapeDtypeStruct(x.shape, x.dtype) for x in leaves])
            closed, shapes = jax.make_jaxpr(function, return_shape=True)(*structs)
            known[key] = Program(closed, columns), jax.tree.structure(shapes)
        program, result = known[key]
        return jax.tree.unflatten(result, native_call.bind(*leaves, program=program))

    return call
