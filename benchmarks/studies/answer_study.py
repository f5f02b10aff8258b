"""How a real vehicle answers its commands: what rates do after a push, by axis and recording.

    python benchmarks/studies/answer_study.py [--output answer.json]

The pool's runs, whose thrusters are reversed at random. From the cross spectra of all six commanded forces and moments
with each rate, H(f) = S_yx S_xx^-1, times 2 pi i f, comes the acceleration that a short push about an axis makes, below
12 Hz. With one delay and one lag, whatever they are, it rises once and dies out. Times of its first push, of the least
after it, and of the next push, with their sizes as shares of the first. Recordings from `$TOWTANK_DATA`, else
`shared/data` beside the repository.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import numpy as np
from real_cases import POOL_RUNS, asked, pool
from report import show
from rich.table import Table
from runner import write_json
from scipy.signal import csd

from towtank.core.arrays import Array
from towtank.identification.data.samples import Samples, prepared, samples_of
from towtank.recording.grids.grid import held_at

RATE, BAND = 100.0, 12.0  # Hz; the band in which there is power
_SPECTRA = {"fs": RATE, "nperseg": 300, "noverlap": 250}
_DRIVEN = {"yaw": (5,), "pitch_roll": (3, 4), "all": (3, 4, 5)}
_NEXT = 0.35  # s in which the second push comes
_AXIS = {3: "roll", 4: "pitch", 5: "yaw"}


def answer(samples: Samples, axis: int) -> tuple[Array, Array]:
    """Return times [s] and the acceleration after a short push about an axis, as a share of its largest."""
    t = np.arange(samples.t[0], min(samples.t[-1], samples.input_t[-1]), 1.0 / RATE)
    wrench = held_at(samples.input_t, samples.input_force, t) @ samples.B.T
    driven = np.flatnonzero(wrench.std(axis=0) > 1e-9).tolist()
    known = np.isfinite(samples.values[:, 6 + axis])
    rate = np.interp(t, samples.t[known], samples.values[known, 6 + axis])
    f = csd(rate, rate, **_SPECTRA)[0]
    across = np.stack([csd(wrench[:, i], rate, **_SPECTRA)[1] for i in driven], axis=-1)
    own = np.stack([np.stack([csd(wrench[:, i], wrench[:, j], **_SPECTRA)[1] for j in driven], -1) for i in driven], -2)
    found = np.einsum("fij,fj->fi", np.linalg.pinv(own, rcond=1e-6, hermitian=True), across)
    H = found[:, driven.index(axis)] * 2j * np.pi * f * np.exp(-((f / BAND) ** 4))
    push = np.fft.irfft(H)[: round(_NEXT * RATE)]
    return np.arange(push.size) / RATE, push / np.abs(push).max()


def pushes(times: Array, push: Array) -> list[tuple[float, float]]:
    """Return time [s] and size of the first push, of the least after it, and of the largest after that."""
    first = int(push[: times.size // 3].argmax())
    least = first + int(push[first : first + times.size // 3].argmin())
    second = least + int(push[least:].argmax())
    return [(float(times[k]), float(push[k])) for k in (first, least, second)]


def main(arguments: Sequence[str] | None = None) -> int:
    """Show how each run answers."""
    output, data = asked(__doc__, arguments)
    if data is None:
        return 0
    runs, document = pool(data), {}
    table = Table(
        "run", "axis", "first push", "then", "next push", title="acceleration after a short push", title_justify="left"
    )
    for name in POOL_RUNS:
        samples = samples_of(prepared(runs.read(name), runs.vehicle), runs.vehicle)
        for axis in _DRIVEN[name.rstrip("_0123456789")]:
            found = pushes(*answer(samples, axis))
            document[f"{name}, {_AXIS[axis]}"] = found
            table.add_row(name, _AXIS[axis], *(f"{size:+.2f} at {t:.2f} s" for t, size in found))
    show(table)
    write_json(output, {"study": "answer", "pushes": document})
    return 0


if __name__ == "__main__":
    sys.exit(main())
