"""Number format: chosen by what the machine has, never by timing."""

import torch


def resolve_precision(wanted: str) -> str:
    """``auto`` → ``bf16`` where the CPU has bf16 arithmetic (AVX-512 or AMX), else ``fp32``; others unchanged."""
    if wanted != "auto":
        return wanted
    has_bf16 = torch.cpu._is_avx512_bf16_supported() or torch.cpu._is_amx_tile_supported()
    return "bf16" if has_bf16 else "fp32"
