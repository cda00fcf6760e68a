"""LLVM: from the text of a module to object code, in this process or in one of its own.

`python emission.py LEVEL SCATTERED LOOPS` reads a module and writes its object code: LLVM lets one thread of a process
in at a time, so what takes seconds is better done beside it (`aside`). This file imports nothing but LLVM, for that.
"""

import functools
import sys

import llvmlite.binding as llvm

llvm.initialize_native_target()
llvm.initialize_native_asmprinter()


def describe() -> str:
    """What machine code depends on besides the module's text: LLVM, the platform, the CPU and its features."""
    return f"LLVM {llvm.llvm_version_info}, {llvm.get_default_triple()}, {llvm.get_host_cpu_name()}, {_features()}"


@functools.cache
def _features() -> str:
    """The features of this CPU, with gather and scatter instructions avoided on x86, where they are slow."""
    own = llvm.get_host_cpu_features().flatten()
    on_x86 = llvm.get_default_triple().startswith(("x86_64", "amd64"))
    return f"{own},+prefer-no-gather,+prefer-no-scatter" if on_x86 else own


def _target_machine(level: int):
    target = llvm.Target.from_default_triple()
    return target.create_target_machine(
        cpu=llvm.get_host_cpu_name(), features=_features(), opt=level, reloc="pic", codemodel="small"
    )


def object_code(text: str, level: int, scattered: bool = False, loops: bool = True) -> bytes:
    """The object code of a module.

    Args:
        text: the module.
        level: LLVM's optimisation level, 0 to 3. At 1 there are none of its passes but those that put numbers from
            memory into registers, and join blocks, for less than half of LLVM's time at 2.
        scattered: whether to search for vectors among scalar instructions (SLP).
        loops: whether loops become vectors and are unrolled, from level 2 on.
    """
    machine = _target_machine(level)
    module = llvm.parse_assembly(text)
    module.triple, module.data_layout = machine.triple, str(machine.target_data)
    options = llvm.create_pipeline_tuning_options(speed_level=level)
    options.slp_vectorization = scattered
    options.loop_vectorization = options.loop_unrolling = loops and level >= 2
    builder = llvm.create_pass_builder(machine, options)
    passes = _into_registers() if level == 1 else builder.getModulePassManager()
    passes.run(module, builder)
    if scattered:  # LLVM's search for them can put an instruction after its uses; to emit that ends the process
        try:
            module.verify()
        except RuntimeError:
            return object_code(text, level, loops=loops)
    return machine.emit_object(module)


def _into_registers():
    """The passes of level 1."""
    passes = llvm.create_new_module_pass_manager()
    passes.add_simplify_cfg_pass()
    passes.add_sroa_pass()
    return passes


if __name__ == "__main__":
    _level, _scattered, _loops = map(int, sys.argv[1:])
    _code = object_code(sys.stdin.buffer.read().decode(), _level, bool(_scattered), bool(_loops))
    sys.stdout.buffer.write(_code)
