"""What a viewer shows of a PDF page, and reads on it."""

from __future__ import annotations

import numpy as np
from pypdfium2 import PdfDocument

from baggie.types import Image


def page_picture(pdf: bytes, dpi: int) -> Image:
    """The first page as an RGB picture `(H, W, 3)`."""
    picture = PdfDocument(pdf)[0].render(scale=dpi / 72, rev_byteorder=True).to_numpy()
    return np.ascontiguousarray(picture[..., :3])


def page_words(pdf: bytes) -> str:
    """All that is written on the first page."""
    return " ".join(PdfDocument(pdf)[0].get_textpage().get_text_bounded().split())
