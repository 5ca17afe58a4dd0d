"""Numba's compiler with what twins need, in less than two thirds of its time.

Numba makes machine code of every function, although only that of the entry function ever runs: all
twins become part of it. Here twins are only lowered, and LLVM optimises the entry function with its
twins once. Passes for code that twins do not contain are left out, and the names of twins lack
their argument types, which are longer than the code.

Other versions of numba may lack what this file imports: `compile_entry` then uses numba's compiler.
"""

# mypy: disallow-subclassing-any=False

from typing import Any, Final

from numba import _dynfunc
from numba.core import typed_passes, untyped_passes
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, _LowerResult
from numba.core.compiler_machinery import LoweringPass, PassManager, register_pass
from numba.core.funcdesc import PythonFunctionDescriptor
from numba.core.lowering import Lower

LARGE: Final = 400
"""Largest function that LLVM may repeat where it is called [instructions as lowered]. It repeats
each one that has a single caller, however large, and its time grows faster than a function does.
With 400 the measurement of a sweep takes half of LLVM's time and runs as fast."""


class _TwinLibrary(JITCodeLibrary):
    """The code of a twin as it was lowered, which is never made machine code."""

    def add_llvm_module(self, module: Any) -> None:
        self._final_module.link_in(module)

    def finalize(self) -> None:
        self._finalized = True


class _EntryLibrary(JITCodeLibrary):
    """The code of an entry function, with the code of all twins."""

    def finalize(self) -> None:
        called: dict[Any, None] = {}
        _list_called(self, called)
        self._linking_libraries: list[Any] = [*called]
        super().finalize()

    def _optimize_final_module(self) -> None:
        """Optimise once: what numba does before that prepares the counting of references."""
        for function in self._final_module.functions:
            # Names of twins are unique only in one process, and this code is loaded by others.
            if function.linkage.name == "linkonce_odr":
                function.linkage = "internal"
        passes, builder = self._codegen._module_pass_manager()
        passes.run(self._final_module, builder)


def _list_called(library: Any, called: dict[Any, None]) -> None:
    """Enter the code that a library calls, and that its twins call."""
    for one in library._linking_libraries:
        if one not in called:
            called[one] = None
            if isinstance(one, _TwinLibrary):
                _list_called(one, called)


@register_pass(mutates_CFG=True, analysis_only=False)
class _LowerTwin(LoweringPass):
    """Lower a function to LLVM's code, for functions that call it."""

    _name = "lower_twin"

    def __init__(self) -> None:
        super().__init__()

    def run_pass(self, state: Any) -> bool:
        context, flags = state.targetctx, state.flags
        library = state.library = _TwinLibrary(context.codegen(), state.func_id.func_qualname)
        described = PythonFunctionDescriptor.from_specialized_function(
            state.func_ir,
            state.typemap,
            state.return_type,
            state.calltypes,
            mangler=lambda name, _, **more: context.mangler(name, (), **more),
            inline=flags.forceinline,
            noalias=flags.noalias,
            abi_tags=[],
        )
        with context.push_code_library(library):
            lower = Lower(context, library, described, state.func_ir, metadata=state.metadata)
            lower.lower()
        size = sum(len(block.instructions) for block in lower.function.blocks)
        if size > LARGE and not flags.forceinline:
            name = described.llvm_func_name
            library.get_function(name).add_function_attribute("noinline")
        # Numba requires an object; Python never calls it.
        module, name = described.lookup_module(), described.qualname
        call = _dynfunc.make_function(module, name, "", 0, lower.env, (library,))
        context.insert_user_function(call, described, [library])
        state.cr = _LowerResult(described, lower.call_helper, cfunc=call, env=lower.env)
        return True


@register_pass(mutates_CFG=True, analysis_only=False)
class _LowerEntry(typed_passes.NativeLowering):
    """Lower an entry function, and make machine code of it with its twins."""

    _name = "lower_entry"

    def run_pass(self, state: Any) -> bool:
        library = _EntryLibrary(state.targetctx.codegen(), state.func_id.func_qualname)
        library.enable_object_caching()
        state.library = library
        return super().run_pass(state)  # type: ignore[no-any-return]


class TwinCompiler(CompilerBase):
    """Compiler of twins."""

    lowering: type[Any] = _LowerTwin

    def define_pipelines(self) -> list[Any]:
        """Return the passes, in order."""
        passes = PassManager("nopython")
        for one in (
            untyped_passes.TranslateByteCode,
            untyped_passes.FixupArgs,
            untyped_passes.IRProcessing,
            untyped_passes.DeadBranchPrune,
            untyped_passes.GenericRewrites,
            untyped_passes.InlineInlinables,
            untyped_passes.ReconstructSSA,
            typed_passes.NopythonTypeInference,
            typed_passes.PreLowerStripPhis,
            typed_passes.NoPythonSupportedFeatureValidation,
            typed_passes.IRLegalization,
            self.lowering,
            typed_passes.NoPythonBackend,
        ):
            passes.add_pass(one)
        passes.finalize()
        return [passes]


class EntryCompiler(TwinCompiler):
    """Compiler of entry functions."""

    lowering = _LowerEntry
