"""The host processor, and the compilation of LLVM code to functions in memory."""

from __future__ import annotations

import contextlib
import ctypes
import ctypes.util
import dataclasses
import importlib.util
import struct
import threading
from collections.abc import Collection, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np

from ....errors import ModelError
from ....progress import watched

#: The levels of x86-64 that are narrower than a processor may be: bits of a vector -> LLVM's name, and whether a b + c
#: is one instruction: SSE2, and AVX2.
_LEVELS = {128: ("x86-64", False), 256: ("x86-64-v3", True)}


@dataclasses.dataclass(frozen=True)
class Processor:
    """A processor by its LLVM name, and the features of its vectors."""

    name: str
    features: str  # as "+avx2,-avx512f"; empty where the name says all
    bits: int  # of a vector
    fma: bool  # whether a b + c is one instruction with one rounding
    masks: bool  # whether parts of vectors are read and written at no cost
    triple: str = ""  # of the target as LLVM names it; empty: this process

    @property
    def narrow(self) -> bool:
        """Whether functions of single precision are computed in it: in double they would take far longer."""
        return bool(self.triple)

    @property
    def longest(self) -> int:
        """Programs of this many operations and more are written in pieces. Compilers of devices join these again."""
        return 20_000 if self.triple else 3000

    @property
    def held(self) -> int | None:
        """How many values straight code holds at a time: three quarters of the registers; None: a device sees to it."""
        few = not self.masks and (self.name in dict(_LEVELS.values()) or "+sse2" in self.features)
        return None if self.triple else 12 if few else 24

    def lanes(self, dtype: np.dtype[Any]) -> int:
        """How many numbers of a floating-point type go into a vector."""
        return self.bits // (8 * dtype.itemsize)

    @classmethod
    def host(cls, bits: int | None = None) -> Processor:
        """The one that runs this, or one with narrower vectors, whose code this one runs too.

        Args:
            bits: of a vector: 128 is SSE2 on x86-64 and NEON on ARM, 256 is AVX2, 512 is AVX-512. The widest if None.
        Raises:
            ImportError: llvmlite is not installed.
            ModelError: this processor has no such vectors.
        """
        import llvmlite.binding as llvm

        features = llvm.get_host_cpu_features()
        widest = 512 if features.get("avx512f") else 256 if features.get("avx2") else 128
        if bits is None or bits == widest:
            fma = bool(features.get("fma")) or llvm.get_default_triple().startswith(("aarch64", "arm64"))
            return cls(llvm.get_host_cpu_name(), features.flatten(), widest, fma, widest == 512)
        if bits not in _LEVELS or bits > widest:
            raise ModelError(f"Processor.host expects bits of at most {widest}, and 128, 256 or 512, got {bits}")
        name, fma = _LEVELS[bits]
        return cls(name, "", bits, fma, False)

    @classmethod
    def widths(cls) -> list[int]:
        """The bits of all vectors that this processor has, narrow ones first."""
        return [bits for bits in (128, 256, 512) if bits <= cls.host().bits]


#: LLVM's level of optimisation of instructions, 0 to 3: at 0 it takes a fifth of the time, and code runs two to four
#: times as long.
LEVEL = 2

_LOCK = threading.Lock()


class BuildError(Exception):
    """Machine code could not be generated; the message says why."""


class MachineCode:
    """Functions in memory, for as long as this object lives.

    Attributes:
        addresses: of functions and variables, by name.
        called: other code that it calls, which lives as long.
    """

    called: Sequence[Any] = ()

    def __init__(self, engines: Sequence[Any], names: Collection[str]) -> None:
        self._engines = engines
        self.addresses: dict[str, int] = _addresses(engines[-1], names)


def _addresses(engine: Any, names: Collection[str]) -> dict[str, int]:
    return {name: engine.get_function_address(name) or engine.get_global_value_address(name) for name in names}


#: The line between texts that are compiled one by one, with one of them in memory at a time.
APART = "\n; ---- compiled apart ----\n"

#: The length of an object file, before its content.
_LENGTH = struct.Struct("<q")

#: In the code model of LLVM's JIT code and constants may lie anywhere. The small one wants them within 2 GB of each
#: other, and LLVM ends the process where they are not: in one that has run for long free memory is farther apart.
_OPTIONS: dict[str, Any] = {"reloc": "pic", "codemodel": "jitdefault", "jit": True}


def installed() -> bool:
    """Whether llvmlite, which compiles kernels, is installed."""
    return importlib.util.find_spec("llvmlite") is not None


def written_by(processor: Processor) -> str:
    """The information, besides the compiled text, on which machine code depends."""
    import llvmlite
    import llvmlite.binding as llvm

    facts = (
        llvmlite.__version__,
        llvm.get_default_triple(),
        processor.name,
        processor.features,
        sorted(_OPTIONS.items()),
        LEVEL,
        _LENGTH.format,
    )
    return repr(facts)


def compiled(text: str, processor: Processor, long: bool = False, packed: bool = False) -> bytes:
    """The machine code of LLVM code, as the contents of object files, each after its length.

    Args:
        text: texts that `APART` divides are compiled one by one. They declare what they call of each other.
        long: the functions are long and straight: LLVM optimises less, and leaves instructions in their order.
        packed: have it put like operations on scalars into vectors (S. Larsen and S. Amarasinghe 2000): as long again.
    Raises:
        ImportError: llvmlite is not installed.
        BuildError: LLVM refuses the text.
    """
    with watched("compile"), compiling(in_order=long):
        machine = _target_machine(processor, min(LEVEL, 1) if long else LEVEL)
        try:
            objects = [_compiled(part, machine, packed) for part in _divided(text)]
        except RuntimeError as error:
            raise BuildError(f"LLVM rejects it: {error}") from error
        return b"".join(_LENGTH.pack(len(code)) + code for code in objects)


def _divided(text: str) -> Iterator[str]:
    """The texts between `APART`, without a copy of all."""
    start = 0
    while (end := text.find(APART, start)) >= 0:
        yield text[start:end]
        start = end + len(APART)
    yield text[start:]


def _compiled(text: str, machine: Any, packed: bool) -> bytes:
    """The content of an object file."""
    import llvmlite.binding as llvm

    # A separate context: everything that it stores, each number of a text, is freed with it.
    parsed = llvm.parse_assembly(text, llvm.create_context())
    parsed.verify()
    if packed:
        tuning = llvm.create_pipeline_tuning_options(speed_level=2)
        tuning.slp_vectorization = True
        passes = llvm.create_pass_builder(machine, tuning)
        passes.getModulePassManager().run(parsed, passes)
    code: bytes = machine.emit_object(parsed)
    return code


#: The versions of LLVM with the option below. Other versions would end the process.
_ORDERED = range(20, 23)


@contextlib.contextmanager
def compiling(in_order: bool) -> Iterator[None]:
    """A context in which LLVM compiles, for one thread at a time.

    Its option of the order of instructions is that of the process: what others compile with llvmlite meanwhile has it
    too. It is set for each text, since the option as it was at first, where each kind of processor has its choice, does
    not come back: that order would depend on what was compiled before.

    Args:
        in_order: instructions stay in their order, in which few numbers wait for their use. LLVM's scheduler of
            instructions lets more wait, which takes registers, and half of the time of a long function.
    """
    import llvmlite.binding as llvm

    def schedule(on: bool) -> None:
        if llvm.llvm_version_info[0] in _ORDERED:
            llvm.set_option("twistax", f"-enable-misched={str(on).lower()}")

    with _LOCK:
        schedule(not in_order)
        try:
            yield
        finally:
            schedule(True)


def load(
    code: bytes,
    library: Collection[str],
    processor: Processor,
    names: Collection[str],
    addresses: Mapping[str, int] = MappingProxyType({}),
    groups: Sequence[Sequence[str]] = (),
) -> MachineCode:
    """The functions and variables with these names.

    Args:
        library: the functions of the C library that are called.
        addresses: of functions of other code that are called.
        groups: the names of the functions of each text after the first one, which calls them.

    Raises:
        ImportError: llvmlite is not installed.
        BuildError: a function of the C library is missing, or LLVM refuses the code.
    """
    import llvmlite.binding as llvm

    with _LOCK:
        for symbol in sorted(library):
            llvm.add_symbol(symbol, _address(symbol))
        for symbol, address in addresses.items():
            llvm.add_symbol(symbol, address)
        engines: list[Any] = []
        try:
            main, *called = _objects(code)
            for part, functions in zip([*called, main], [*groups, ()], strict=True):
                # An engine for each: LLVM reads constants of one object by the table of offsets of another one.
                engines.append(llvm.create_mcjit_compiler(llvm.parse_assembly(""), _target_machine(processor, LEVEL)))
                engines[-1].add_object_file(llvm.ObjectFileRef.from_data(part))
                engines[-1].finalize_object()
                for symbol, address in _addresses(engines[-1], functions).items():
                    llvm.add_symbol(symbol, address)
        except RuntimeError as error:
            raise BuildError(f"LLVM rejects it: {error}") from error
        return MachineCode(engines, names)


def _objects(code: bytes) -> Iterator[bytes]:
    start = 0
    while start < len(code):
        first = start + _LENGTH.size
        start = first + _LENGTH.unpack_from(code, start)[0]
        yield code[first:start]


def _target_machine(processor: Processor, level: int) -> Any:
    import llvmlite.binding as llvm

    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    return llvm.Target.from_default_triple().create_target_machine(
        cpu=processor.name, features=processor.features, opt=level, **_OPTIONS
    )


def _address(symbol: str) -> int:
    """The address of a function of the C library, looked up because LLVM ends the process for a missing one."""
    # Search libraries, which takes time, only if the process itself has no such function.
    for name in (None, "m", "c"):
        try:
            function = getattr(ctypes.CDLL(name and ctypes.util.find_library(name)), symbol)
        except (AttributeError, OSError, TypeError):
            continue
        address = ctypes.cast(function, ctypes.c_void_p).value
        if address:
            return address
    raise BuildError(f"the C library has no {symbol}")
