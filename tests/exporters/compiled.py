"""The C header of a vehicle, compiled, for tests: its functions over arrays of states."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from towtank.exporters.programs.c99 import header_text
from towtank.vehicle import Vehicle

COMPILERS = {
    "gcc": ("gcc", "-std=c99"),
    "clang": ("clang", "-std=c99"),
    "g++": ("g++", "-std=c++17", "-x", "c++"),
    "clang++": ("clang++", "-std=c++17", "-x", "c++"),
}
STRICT = ("-Wall", "-Wextra", "-Werror", "-pedantic", "-Wconversion")
_DRIVER = """
#include "model.h"
#ifdef __cplusplus
extern "C" {
#endif
static m_model model;
int prepare(void) { const m_parameters p = m_default_parameters(); return m_prepare(&p, &model); }
int self_test(void) { return m_self_test(); }
void forward(int n, const m_real *q, const m_real *nu, const m_real *tau, m_real *out)
{ int i; for (i = 0; i < n; i++) m_forward_dynamics(&model, q + 4 * i, nu + 6 * i, tau + 6 * i, out + 6 * i); }
void inverse(int n, const m_real *q, const m_real *nu, const m_real *nu_dot, m_real *out)
{ int i; for (i = 0; i < n; i++) m_inverse_dynamics(&model, q + 4 * i, nu + 6 * i, nu_dot + 6 * i, out + 6 * i); }
void quaternions(int n, const m_real *euler, m_real *q, m_real *back)
{ int i; for (i = 0; i < n; i++) { m_quaternion(euler + 3 * i, q + 4 * i); m_euler(q + 4 * i, back + 3 * i); } }
void run(int n, m_real *x, const m_real *tau, const m_real *current, m_real dt, m_real *out)
{ int i, j; for (i = 0; i < n; i++) { m_step(&model, x, tau + 6 * i, current, dt);
  for (j = 0; j < M_STATES; j++) out[M_STATES * i + j] = x[j]; } }
#ifdef WITH_THRUSTERS
void wrenches(int n, const m_real *commands, m_real voltage, m_real *out)
{ int i; for (i = 0; i < n; i++) m_thruster_wrench(commands + M_THRUSTERS * i, voltage, out + 6 * i); }
void allocations(int n, const m_real *tau, m_real voltage, m_real *out)
{ int i; for (i = 0; i < n; i++) m_allocate(tau + 6 * i, voltage, out + M_THRUSTERS * i); }
void run_commands(int n, m_real *x, const m_real *commands, const m_real *current, m_real dt, m_real *out)
{ int i, j; m_real forces[M_THRUSTERS]; const m_real none[6] = { 0 };
  for (j = 0; j < M_THRUSTERS; j++) forces[j] = 0;
  for (i = 0; i < n; i++) { m_step_commands(&model, x, forces, commands + M_THRUSTERS * i, 0, none, current, dt);
  for (j = 0; j < M_STATES; j++) out[M_STATES * i + j] = x[j]; } }
#endif
#ifdef __cplusplus
}
#endif
"""


def built(vehicle: Vehicle, folder: Path, compiler: str = "gcc", *, single: bool = False, level: str = "-O2") -> Path:
    """Return the shared library of a vehicle's header, compiled with every warning as an error."""
    folder.joinpath("model.h").write_text(header_text(vehicle, single=single, prefix="m"))
    source, library = folder / "driver.c", folder / f"{compiler}.so"
    source.write_text(_DRIVER)
    thrusters = ("-DWITH_THRUSTERS",) if vehicle.thrusters else ()
    command = [*COMPILERS[compiler], level, *STRICT, *thrusters, "-fPIC", "-shared", str(source)]
    subprocess.run([*command, "-x", "none", "-o", str(library), "-lm"], check=True, capture_output=True, text=True)
    return library


def has(compiler: str) -> bool:
    return shutil.which(COMPILERS[compiler][0]) is not None


class Compiled:
    """A vehicle's header as functions of arrays."""

    def __init__(self, library: Path, *, single: bool = False) -> None:
        self._library = ctypes.CDLL(str(library))
        self._type: Any = np.float32 if single else np.float64
        self._number = ctypes.c_float if single else ctypes.c_double
        if self._library.prepare() != 0:
            raise ValueError("the mass matrix is not positive definite")

    @property
    def wrong(self) -> int:
        return int(self._library.self_test())

    def call(self, name: str, inputs: list[Any], *columns: int) -> tuple[NDArray[np.float64], ...]:
        """Call a function with arrays and numbers, and return its outputs (n, columns)."""
        arrays = [np.ascontiguousarray(each, self._type) if np.ndim(each) else each for each in inputs]
        n = max(len(each) for each in arrays if np.ndim(each) == 2)
        outputs = [np.empty((n, width), self._type) for width in columns]
        given = [ctypes.c_void_p(each.ctypes.data) if np.ndim(each) else self._number(each) for each in arrays]
        given += [ctypes.c_void_p(each.ctypes.data) for each in outputs]
        getattr(self._library, name)(ctypes.c_int(n), *given)
        return tuple(each.astype(np.float64) for each in outputs)
