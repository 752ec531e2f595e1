"""Kernels: functions of numbers and arrays that numba compiles. Nobody else names numba.

A kernel is compiled when it is first called with arguments of some types, and kept by content: by
its bytecode, the constants it uses, the kernels it calls, Python, numba, and the CPU it is for. So
no edit, move or clone ever meets code of other text, and whoever has the same text shares it. It is
looked for beside the package (what a wheel brings), then in the user's folder for caches, and
written to the latter alone; what cannot be read there is compiled again.

Code is for x86-64-v3 (AVX2) where the CPU has that, so that one such machine can take what another
compiled; elsewhere for the CPU there is. No flag lets the compiler change a result: no fast-math,
no contraction. So the bits are those of any other target (``NUMBA_CPU_NAME``, where set, counts).

What kernels call is linked to them first, and optimized and made machine code with them: neither
is done for each function that is a part of others. A function that makes no array counts no
references (numba cannot leave that out around loops: it was half the time of a ray's walk).

Importing this module costs no import of numba; the first call of a kernel does.
"""

from __future__ import annotations

import functools
import gc
import hashlib
import os
import pickle
import platform
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from opcode import opmap
from pathlib import Path
from threading import RLock, current_thread, get_ident, main_thread
from types import BuiltinFunctionType, CodeType, FrameType, FunctionType, ModuleType
from typing import Any, ClassVar

from scenec.schemas.files import make_private_folder, refused_folder

#: Compiled kernels that came with the package.
SHIPPED = Path(__file__).resolve().parent / "compiled"
_FEATURES_OF_V3 = ("avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe")
#: Versions of numba whose inside is known here.
_KNOWN = ("0.68.",)
#: Changes with what a file of a kernel holds.
_FORMAT = 2
_OPTIONS = {"error_model": "numpy", "nogil": True, "no_cfunc_wrapper": True}
_making = RLock()


class Kernel:
    """Wraps a decorated function, to be called from Python or from other kernels."""

    def __init__(self, function: FunctionType, inline: bool) -> None:
        self.py_func = function
        self._inline = inline
        self._entry: Callable[..., Any] | None = None
        functools.update_wrapper(self, function)

    def __call__(self, *arguments: Any) -> Any:
        """Computes; compiles, if it is the first time with such arguments."""
        entry = self._entry
        return entry(*arguments) if entry is not None else self._compiled()(*arguments)

    def _compiled(self) -> Callable[..., Any]:
        """The dispatcher that Python calls."""
        with _making:
            if self._entry is None:
                options = {"pipeline_class": _compilers()[0], **_OPTIONS}
                self._entry = _numba().njit(**options)(self.py_func)
                if hasattr(self._entry, "_cache"):
                    self._entry._cache = _FileCache(self)
            return self._entry

    @functools.cached_property
    def _called(self) -> Any:
        """The dispatcher that other kernels call: of their code, so nothing of it is kept."""
        inline = {"forceinline": True} if self._inline else {}
        options = {"no_cpython_wrapper": True, "pipeline_class": _compilers()[1], **_OPTIONS}
        return _typed(_numba().njit(**options, **inline)(self.py_func))

    @property
    def _numba_type_(self) -> Any:
        """Returns numba's type of the kernel, for kernels that call it."""
        return self._called._numba_type_

    @functools.cached_property
    def content(self) -> str:
        """Hash of all that decides what it computes, but the types of its arguments.

        Raises:
            TypeError: It uses what has no content to hash: a Python function, a module of ours.
        """
        return _content(self.py_func, (_OPTIONS, self._inline))


def kernel(function: Callable[..., Any]) -> Kernel:
    """Compiles a function when it is first called.

    Divides like NumPy (no exception) and gives up the interpreter's lock (``schemas.threads``).
    """
    assert isinstance(function, FunctionType)
    return Kernel(function, inline=False)


def inlined(function: Callable[..., Any]) -> Kernel:
    """A kernel whose code becomes part of the kernels that call it: for the small and the often."""
    assert isinstance(function, FunctionType)
    return Kernel(function, inline=True)


class Intrinsic:
    """A function of kernels that is defined by the code it stands for."""

    def __init__(self, definition: FunctionType) -> None:
        self.definition = definition
        self.__doc__ = definition.__doc__

    def __call__(self, *arguments: Any) -> Any:
        """Kernels alone call it.

        Raises:
            TypeError: Python did.
        """
        raise TypeError(f"{self.definition.__qualname__} is for kernels")

    @functools.cached_property
    def _numba_type_(self) -> Any:
        """Returns numba's type of the intrinsic, for kernels that call it."""
        _numba()
        from numba.core.registry import cpu_target
        from numba.extending import intrinsic

        made = intrinsic(self.definition)
        cpu_target.typing_context.refresh()
        return cpu_target.typing_context.resolve_value_type(made)


def intrinsic(definition: Callable[..., Any]) -> Intrinsic:
    """Wraps ``numba.extending.intrinsic``; the definition imports what it needs of numba."""
    assert isinstance(definition, FunctionType)
    return Intrinsic(definition)


@functools.cache
def _numba() -> ModuleType:
    """numba, set up."""
    # Most errors are those of overloads that do not fit, and never seen.
    os.environ.setdefault("NUMBA_DISABLE_ERROR_MESSAGE_HIGHLIGHTING", "1")
    import numba
    from llvmlite import binding
    from numba.core import config

    if config.CPU_NAME is None and platform.machine() in ("x86_64", "AMD64"):
        features = binding.get_host_cpu_features()
        if all(features.get(name) for name in _FEATURES_OF_V3):
            config.CPU_NAME, config.CPU_FEATURES = "x86-64-v3", ""
    return numba


def _typed(dispatcher: Any) -> Any:
    """The same, compiled once for all constants that calls name: else once for each."""
    from numba.core.types.misc import unliteral

    resolve = dispatcher.get_call_template

    def get_call_template(arguments: Any, named: Any) -> Any:
        named = {name: unliteral(kind) for name, kind in named.items()}
        return resolve(tuple(unliteral(kind) for kind in arguments), named)

    dispatcher.get_call_template = get_call_template
    return dispatcher


@functools.cache
def _compilers() -> tuple[type, type]:
    """Returns the compiler of kernels that Python calls, and that of the parts of these.

    As numba does, for less: most of what that takes is work on text of its own in Python. It leans
    on what numba offers nobody: where another numba is installed, that compiles as it does.
    """
    version = _numba().__version__
    from numba.core.compiler import Compiler, DefaultPassBuilder

    if not version.startswith(_KNOWN):
        return Compiler, Compiler
    from llvmlite.binding import Linkage
    from numba.core import typing
    from numba.core.codegen import JITCodeLibrary
    from numba.core.compiler_machinery import AnalysisPass, register_pass
    from numba.core.datamodel import register_default
    from numba.core.datamodel.models import TupleModel, UniTupleModel
    from numba.core.registry import cpu_target
    from numba.core.typed_passes import NopythonRewrites, NopythonTypeInference
    from numba.core.types.containers import NamedTuple, NamedUniTuple
    from numba.core.untyped_passes import InlineClosureLikes

    class Whole:
        """A tuple that functions take as it is, not number by number (145 of ``Geometry``)."""

        def get_argument_type(self) -> Any:
            return self.get_value_type()  # type: ignore[attr-defined]

        def as_argument(self, builder: Any, value: Any) -> Any:
            return value

        def from_argument(self, builder: Any, value: Any) -> Any:
            return value

    register_default(NamedTuple)(type("WholeTuple", (Whole, TupleModel), {}))
    register_default(NamedUniTuple)(type("WholeUniTuple", (Whole, UniTupleModel), {}))

    class Typing(typing.Context):
        """Extends numba's table of types: looks up an operator's result for some types once."""

        found: ClassVar[dict[Any, Any]] = {}

        def resolve_function_type(self, func: Any, args: Any, kws: Any) -> Any:
            if kws or not isinstance(func, BuiltinFunctionType):
                return super().resolve_function_type(func, args, kws)
            if (func, args) not in self.found:
                self.found[func, args] = super().resolve_function_type(func, args, kws)
            return self.found[func, args]

    known = Typing.__new__(Typing)
    known.__dict__ = cpu_target.typing_context.__dict__

    @register_pass(mutates_CFG=False, analysis_only=True)
    class Borrow(AnalysisPass):
        """Lets functions that own no array count no references."""

        _name = "borrow"

        def __init__(self) -> None:
            super().__init__()

        def run_pass(self, state: Any) -> bool:
            if _owns_nothing(state):
                state.flags.nrt = False
                state.targetctx = state.targetctx.subtarget(enable_nrt=False)
            return False

    @register_pass(mutates_CFG=True, analysis_only=False)
    class Fuse(NopythonRewrites):
        """Fuses operations on arrays, of which functions that own none have none."""

        def run_pass(self, state: Any) -> bool:
            return bool(state.flags.nrt and super().run_pass(state))

    class Linked(JITCodeLibrary):
        """Code that is optimized once, with all its parts."""

        def _optimize_functions(self, module: Any) -> None:
            pass

        def _link_parts(self, module: Any) -> None:
            """Adds the code of all that this one reaches to a module."""
            waiting, found = self._linking_libraries[::-1], {self}
            while waiting:
                library = waiting.pop()
                if library in found:
                    continue
                found.add(library)
                self._reload_init.update(library._reload_init)
                if isinstance(library, Part):
                    waiting += library._linking_libraries[::-1]
                    module.link_in(library._final_module, preserve=True)
                else:
                    module.link_in(library._get_module_for_linking(), preserve=True)

    class Part(Linked):
        """Holds a lowered function, to be linked to its callers; it has no address."""

        _shared_module: Any

        def finalize(self) -> None:
            for function in self._final_module.functions:
                if not function.is_declaration and function.linkage == Linkage.external:
                    function.linkage = Linkage.linkonce_odr
            self._finalize_dynamic_globals()
            self._finalized = True

        def _get_module_for_linking(self) -> Any:
            """With its parts, for callers that are no kernels."""
            if self._shared_module is None:
                self._shared_module = self._final_module.clone()
                self._link_parts(self._shared_module)
            return self._shared_module

        def get_pointer_to_function(self, name: str) -> int:
            self._ensure_finalized()
            return 0

        @property
        def codegen(self) -> Part:
            return self

        def set_env(self, env_name: str, env: object) -> None:
            """Leaves it to callers, which own the process (``_FileCache.save_overload``)."""

    class Entry(Linked):
        """Holds a kernel that Python calls."""

        def finalize(self) -> None:
            self._link_parts(self._final_module)
            self._linking_libraries.clear()
            super().finalize()

        def _optimize_final_module(self) -> None:
            passes, builder = self._codegen._module_pass_manager()
            passes.run(self._final_module, builder)

    class EntryCompiler(Compiler):
        def __init__(self, _: Any, target: Any, library: Any, *others: Any) -> None:
            super().__init__(known, target, library or self.new_library(target), *others)

        def new_library(self, target: Any) -> Any:
            library = Entry(target.codegen(), "kernel")
            library.enable_object_caching()
            return library

        def define_pipelines(self) -> list[Any]:
            made = DefaultPassBuilder.define_nopython_pipeline(self.state)
            made.add_pass_after(Borrow, NopythonTypeInference)
            inner = any(isinstance(c, CodeType) for c in self.state.func_id.code.co_consts)
            made.passes = [
                (Fuse if each is NopythonRewrites else each, told)
                for each, told in made.passes
                if inner or each is not InlineClosureLikes
            ]
            made.finalize()
            return [made]

        def _compile_bytecode(self) -> Any:
            codegen = self.state.targetctx.codegen()
            # Functions of numba's that it calls are parts, too.
            codegen._library_class, before = Part, codegen._library_class
            # Nothing of a compilation is garbage before its end: to look for some takes 5 % of it.
            collects = gc.isenabled()
            gc.disable()
            try:
                return super()._compile_bytecode()
            finally:
                codegen._library_class = before
                if collects:
                    gc.enable()

    class PartCompiler(EntryCompiler):
        def new_library(self, target: Any) -> Any:
            return Part(target.codegen(), "part")

    return EntryCompiler, PartCompiler


def _owns_nothing(state: Any) -> bool:
    """Whether a function, typed, neither makes nor returns what has owners, as arrays have.

    All that it names is then its caller's, or part of that, for as long as it runs. Putting an
    array into another one makes a copy, in case they overlap.
    """
    from numba.core import ir
    from numba.core.types.containers import BaseTuple
    from numba.core.types.functions import NamedTupleClass
    from numba.core.types.misc import SliceType
    from numba.core.types.scalars import Integer

    def is_owned(kind: Any) -> bool:
        model = state.targetctx.data_model_manager[kind]
        return bool(model.contains_nrt_meminfo())

    def is_place(index: Any) -> bool:
        # An array of indices, or of truths, would make a copy.
        if isinstance(index, BaseTuple):
            return all(map(is_place, index))
        return isinstance(index, Integer | SliceType)

    def is_view(value: Any) -> bool:
        if isinstance(value, ir.Arg | ir.Var):
            return True
        if not isinstance(value, ir.Expr):
            return False
        if value.op == "getitem":
            return is_place(state.typemap[value.index.name])
        if value.op == "call":
            return isinstance(state.typemap[value.func.name], NamedTupleClass)
        return value.op in ("getattr", "static_getitem", "build_tuple", "cast", "phi")

    blocks = state.func_ir.blocks.values()
    return (
        not is_owned(state.return_type)
        and all(
            is_view(each.value) or not is_owned(state.typemap[each.target.name])
            for block in blocks
            for each in block.find_insts(ir.Assign)
        )
        and not any(
            is_owned(state.typemap[each.value.name])
            for block in blocks
            for kind in (ir.SetItem, ir.StaticSetItem)
            for each in block.find_insts(kind)
        )
    )


def user_folder() -> Path:
    """Returns the folder of kernels: ``$NUMBA_CACHE_DIR``, or in the user's folder for caches."""
    if chosen := os.environ.get("NUMBA_CACHE_DIR"):
        return Path(chosen, "scenec")
    home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(home, "scenec", "kernels")


def _private_folder() -> Path | None:
    """``user_folder``; None, which is said once, where others could put code there."""
    folder = user_folder()
    if (why := refused_folder(folder)) is None:
        return folder
    from scenec.schemas.notice import tell

    tell(f"kernels {folder}: {why}; they are compiled each time")
    return None


def _content(function: FunctionType, options: object = None) -> str:
    """Computes ``Kernel.content`` of a function."""
    digest = hashlib.sha256(repr(options).encode())
    named: set[str] = set()
    attributes: set[str] = set()

    def take(code: CodeType) -> None:
        consts = [c for c in code.co_consts if c != function.__doc__]
        plain = [
            repr(sorted(map(repr, c)) if isinstance(c, frozenset) else c)
            for c in consts
            if not isinstance(c, CodeType)
        ]
        shape = code.co_argcount, code.co_varnames, code.co_names, code.co_freevars, code.co_flags
        digest.update(repr((code.co_code, plain, shape)).encode())
        named.update(_globals_of(code))
        attributes.update(code.co_names)
        for other in consts:
            if isinstance(other, CodeType):
                take(other)

    take(function.__code__)
    known = function.__globals__
    cells = zip(function.__code__.co_freevars, function.__closure__ or (), strict=True)
    values = {name: known[name] for name in sorted(named) if name in known}
    values |= {name: cell.cell_contents for name, cell in cells}
    for name, value in list(values.items()):
        if isinstance(value, ModuleType) and value.__name__.startswith("scenec."):
            del values[name]
            inside = sorted(attributes & set(vars(value)))
            values |= {f"{name}.{each}": getattr(value, each) for each in inside}
    for name, value in values.items():
        content = "itself" if getattr(value, "py_func", None) is function else _of_value(value)
        if content is None and "." not in name:
            raise TypeError(f"the kernel {function.__qualname__} uses {name}, which has no content")
        digest.update(f"{name}={content};".encode())
    digest.update(repr(function.__defaults__).encode())
    return digest.hexdigest()


def _globals_of(code: CodeType) -> set[str]:
    """Names that bytecode looks up in its module."""
    globals_read: set[str] = set()
    more = 0
    for operation, argument in zip(code.co_code[::2], code.co_code[1::2], strict=True):
        argument |= more
        more = argument << 8 if operation == opmap["EXTENDED_ARG"] else 0
        if operation == opmap["LOAD_GLOBAL"]:
            globals_read.add(code.co_names[argument >> 1])
    return globals_read


def _of_value(value: Any) -> str | None:
    """The content of what a kernel names; None: it has none that could be told."""
    import numpy as np

    if isinstance(value, Kernel):
        return value.content
    if isinstance(value, bool | int | float | complex | str | bytes | None):
        return repr(value)
    if isinstance(value, tuple):
        return f"({','.join(str(_of_value(each)) for each in value)})"
    if isinstance(value, np.ndarray | np.generic):
        return f"{value.dtype.str}{np.shape(value)}{hashlib.sha256(value.tobytes()).hexdigest()}"
    if isinstance(value, type):
        return f"{value.__module__}.{value.__qualname__}{getattr(value, '_fields', '')}"
    if isinstance(value, Intrinsic):
        return _content(value.definition)
    module = str(getattr(value, "__module__", ""))
    known = isinstance(value, ModuleType) or (callable(value) and not module.startswith("scenec"))
    return f"{module}.{value.__name__}" if known else None


@contextmanager
def _uninterrupted() -> Iterator[None]:
    """Puts Ctrl-C off until the end.

    LLVM asks for kept code by a callback. An interrupt that Python raises in there is printed and
    forgotten, and what follows is a kernel without code, at address 0.
    """
    before = signal.getsignal(signal.SIGINT)
    if current_thread() is not main_thread() or not callable(before):
        yield
        return
    came: list[tuple[int, FrameType | None]] = []
    signal.signal(signal.SIGINT, lambda number, frame: came.append((number, frame)))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
        if came:
            before(*came[0])


class _FileCache:
    """Compiled kernels in files: what numba's dispatchers take for their cache."""

    cache_path = None

    def __init__(self, of: Kernel) -> None:
        self._of = of

    @_uninterrupted()
    def load_overload(self, signature: Any, context: Any) -> Any:
        """Returns the code compiled for these types, or None: numba then compiles it."""
        from numba.core.compiler import CompileResult
        from numba.core.runtime import rtsys

        name = self._name(signature, context.codegen())
        for folder in filter(None, (SHIPPED, _private_folder())):
            try:
                data = (folder / name).read_bytes()
            except OSError:
                continue
            if data[:32] != hashlib.sha256(memoryview(data)[32:]).digest():
                continue
            # What compiled code needs; a refresh would import all that compiling does (0.3 CPU s).
            rtsys.initialize(context)
            with suppress(ImportError, AttributeError):
                library, described, *others = pickle.loads(memoryview(data)[32:])  # noqa: S301 (from the user's own cache, or the wheel)
                # The one name that is asked for; numba takes it from what ``save_overload`` spares.
                context.codegen()._engine._defined_symbols.add(described.llvm_cpython_wrapper_name)
                return CompileResult._rebuild(context, library, described, *others)
        return None

    def save_overload(self, signature: Any, result: Any) -> None:
        """Keeps what was compiled, where that is possible; its parts get their environments."""
        from llvmlite import binding
        from numba.core.serialize import dumps

        for environment in result._find_referenced_environments():
            result.codegen.set_env(environment.env_name, environment)
        if result.library.has_dynamic_globals:
            return  # Such code holds addresses of this process.
        (name, kind, (code, _)), *others, referenced = result._reduce()
        # In place of what a kernel that calls this one would need of it: none does, and to read it
        # takes longer than all the rest. The code of its parts takes nothing but constants of their
        # environments: to read those without would import their modules, SciPy's algebra with one.
        code = name, kind, (code, binding.parse_assembly("").as_bitcode())
        needed = tuple(each for each in referenced if each.consts or each is result.environment)
        data = dumps((code, *others, needed))
        folder = _private_folder()
        if folder is None:
            return
        try:
            make_private_folder(folder)
            name = self._name(signature, result.codegen)
            path = folder / f".{name}-{os.getpid()}-{get_ident()}"
            path.write_bytes(hashlib.sha256(data).digest() + data)
            path.replace(folder / name)
        except OSError:
            return

    def _name(self, signature: Any, codegen: Any) -> str:
        content = self._of.content, str(signature), codegen.magic_tuple(), _versions()
        digest = hashlib.sha256(repr(content).encode()).hexdigest()[:24]
        function = self._of.py_func
        module = function.__module__.removeprefix("scenec.")
        return f"{module}.{function.__name__}-{digest}"

    def flush(self) -> None:
        """Nothing waits to be written."""


@functools.cache
def _versions() -> tuple[object, ...]:
    import llvmlite
    import numpy as np

    numba = _numba()
    tag = sys.implementation.cache_tag
    return _FORMAT, tag, np.__version__, numba.__version__, llvmlite.__version__
