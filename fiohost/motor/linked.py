"""How the parts of a kernel come together, so that each is compiled once.

Numba optimises every function that it meets and makes machine code of it, though only an entry kernel's is ever run,
and each kernel that calls another holds a copy of it all. Here a part is a draft, linked into its kernel and optimised
there, and an entry kernel that others call is found by its name when they are loaded. Without this the first use of
all kernels takes twice the time.
"""

from __future__ import annotations

import gc
from collections.abc import Callable, Mapping
from functools import partial
from importlib import import_module
from typing import Any

from llvmlite.binding import add_symbol
from numba.core.cgutils import get_or_insert_function, if_unlikely, unpack_tuple
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.extending import intrinsic, overload

OBJECTS = 50_000  # that are made between two looks for garbage; some 10 MB


class Draft(JITCodeLibrary):
    """Code of a part: linked with what it calls, but optimised and made into machine code only within its kernel."""

    def __init__(self, codegen: Any, name: str, attribute: str) -> None:
        super().__init__(codegen, name)
        self.attribute = attribute

    def finalize(self) -> None:
        for function in self._final_module.functions:
            if self.attribute and not function.is_declaration:
                function.add_function_attribute(self.attribute)
        for library in dict.fromkeys(self._linking_libraries):
            self._reload_init.update(library._reload_init)
            self._final_module.link_in(library._get_module_for_linking(), preserve=True)
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        """No machine code, so none."""
        self._ensure_finalized()
        return 0

    @property
    def codegen(self) -> Any:
        """Asked to tell machine code where its environment is."""
        return self

    def set_env(self, name: str, env: Any) -> None:
        """No machine code, so nothing reads it."""


class EntryCompiler(Compiler):
    """Numba's own, but that garbage is looked for more seldom: a compiler makes many objects that live on."""

    def compile_extra(self, func: Any) -> Any:
        kept = gc.get_threshold()
        gc.set_threshold(kept[0] and max(kept[0], OBJECTS), *kept[1:])
        try:
            return super().compile_extra(func)
        finally:
            gc.set_threshold(*kept)


class PartCompiler(Compiler):
    """Numba's own, but that the code goes into a draft: of a part that is called wherever it is used."""

    attribute = "noinline"

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        if self.state.library is None:
            self.state.library = Draft(self.state.targetctx.codegen(), "part", self.attribute)


class InlinedCompiler(PartCompiler):
    """Of a part that is put into its callers, however many there are."""

    attribute = "alwaysinline"


class HelperCompiler(PartCompiler):
    """Of a part that is put into its callers where LLVM finds it small enough."""

    attribute = ""


def call_by_address(function: Any, entry: Any, signature: Any, options: Mapping[str, Any]) -> None:
    """Let kernels call a Python function by the address of ``entry``, its dispatcher, for a signature."""
    function.entry, function.signature = entry, signature
    given: Any = signature.args

    @intrinsic
    def at_its_address(typing, args):  # type: ignore[no-untyped-def]
        def call(context, builder, _, values):  # type: ignore[no-untyped-def]
            ready = partial(provide, function.__module__, function.__name__)
            context.active_code_library._reload_init.add(ready)  # for a caller that is loaded from the cache
            kind = context.call_conv.get_function_type(signature.return_type, given)
            callee = get_or_insert_function(builder.module, kind, ready())
            parts = [
                context.cast(builder, value, have, want)
                for value, have, want in zip(unpack_tuple(builder, values[0]), args, given, strict=True)
            ]
            status, found = context.call_conv.call_function(builder, callee, signature.return_type, given, parts)
            with if_unlikely(builder, status.is_error):
                context.call_conv.return_status_propagate(builder, status)
            return found

        return signature.return_type(args), call

    at: Callable[..., Any] = at_its_address

    @overload(function, jit_options=dict(options), strict=False)  # type: ignore[arg-type]
    def from_kernel(*args):  # type: ignore[no-untyped-def]
        return lambda *args: at(args)


def provide(module: str, name: str) -> str:
    """See that a kernel is there that others call, and that its name is known to all that is loaded from now on."""
    kernel = getattr(import_module(module), name)
    kernel.entry.compile(kernel.signature)
    made = kernel.entry.overloads[kernel.signature.args]
    symbol = f"{module}.{name}"
    add_symbol(symbol, made.library.get_pointer_to_function(made.fndesc.llvm_func_name))
    return symbol
