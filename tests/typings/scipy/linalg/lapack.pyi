"""Types of what armflex asks of LAPACK, whose wrappers have none; the last answer says whether it worked."""

import numpy as np
from numpy.typing import NDArray

_Array = NDArray[np.float64]

def dgeqrf(a: _Array, lwork: int = ..., overwrite_a: int = ...) -> tuple[_Array, _Array, _Array, int]: ...
def dposv(a: _Array, b: _Array, lower: int = ..., overwrite_a: int = ...) -> tuple[_Array, _Array, int]: ...
def dpotrf(a: _Array, lower: int = ..., clean: int = ..., overwrite_a: int = ...) -> tuple[_Array, int]: ...
def dtrtrs(
    a: _Array,
    b: _Array,
    lower: int = ...,
    trans: int = ...,
    unitdiag: int = ...,
    lda: int = ...,
    overwrite_b: int = ...,
) -> tuple[_Array, int]: ...
def dtrtri(c: _Array, lower: int = ..., unitdiag: int = ..., overwrite_c: int = ...) -> tuple[_Array, int]: ...
