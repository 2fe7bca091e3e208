"""HMM-MOS: the method, its map of beliefs, and its kernels."""

from dynaviz_methods.hmm_mos.method import HmmMos, HmmMosParams

__all__ = ["HmmMos", "HmmMosParams"]
