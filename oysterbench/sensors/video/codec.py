"""Video over a tether: a hybrid integer codec that degrades texture as H.264 does, at a given bit rate.

Each group starts with an intra-predicted frame; the others are predicted from the previous one by motion-compensated
macroblocks. The residual is transformed, quantised and entropy-coded, the latter only to get its size, by which rate
control sets the quantiser. The decoded frames are what a recorder at the surface receives. The codec runs over the
frames of a sequence in order, once they exist.
"""

from __future__ import annotations

import math

import numpy as np
import warp as wp
from numpy.typing import NDArray

from oysterbench.render.target import start_warp
from oysterbench.sensors.video.motion import quarter, search
from oysterbench.sensors.video.planes import deblock, join_colours, split_colours
from oysterbench.sensors.video.prediction import code_inter, code_intra
from oysterbench.sensors.video.transform import Quantiser

GROUP_S = 2.0  # time from one intra frame to the next
ENTROPY = 0.75  # ratio of bits in adaptive codes (CAVLC, CABAC) to those in Exp-Golomb codes (Richardson 2010, 7.4)
INTRA_WEIGHT = 4.0  # ratio of the bits of an intra frame to those of the others
BUFFER_S = 1.0  # time in which rate control makes up for excess bits
LOWEST_QP, HIGHEST_QP, FIRST_QP = 10, 51, 28
QUICKEST = 4  # most steps by which the quantiser changes from one frame to the next
SCALE = (
    (13107, 5243, 8066),
    (11916, 4660, 7490),
    (10082, 4194, 6554),
    (9362, 3647, 5825),
    (8192, 3355, 5243),
    (7282, 2893, 4559),
)
STEP = ((10, 16, 13), (11, 18, 14), (13, 20, 16), (14, 23, 18), (16, 25, 20), (18, 29, 23))
ZIGZAG = (0, 1, 4, 8, 5, 2, 3, 6, 9, 12, 13, 10, 7, 11, 14, 15)
CHROMA_QP = (29, 30, 31, 32, 32, 33, 34, 34, 35, 35, 36, 36, 37, 37, 37, 38, 38, 38, 39, 39, 39, 39)  # from 30 on
# fmt: off
ALPHA = (  # thresholds of the loop filter, for quantisers from 16 on
    4, 4, 5, 6, 7, 8, 9, 10, 12, 13, 15, 17, 20, 22, 25, 28, 32, 36, 40, 45, 50, 56, 63, 71, 80, 90, 101, 113, 127, 144,
    162, 182, 203, 226, 255, 255,
)
BETA = (
    2, 2, 2, 3, 3, 3, 3, 4, 4, 4, 6, 6, 7, 7, 8, 8, 9, 9, 10, 10, 11, 11, 12, 12, 13, 13, 14, 14, 15, 15, 16, 16,
    17, 17, 18, 18,
)
# fmt: on


class VideoCodec:
    """Coder and decoder of the frames (H, W, 3) of one camera, in order. bits, qp: size and quantiser of the last."""

    def __init__(self, height: int, width: int, rate_hz: float, mbit_s: float) -> None:
        start_warp()
        self.shape = (height, width)
        self.qp = FIRST_QP
        self.bits = 0
        self._group = max(round(GROUP_S * rate_hz), 1)
        per_picture = mbit_s * 1e6 / rate_hz
        self._plain_bits = per_picture * self._group / (self._group - 1 + INTRA_WEIGHT)
        self._made_up_in = max(BUFFER_S * rate_hz, 1.0)
        self._owed = 0.0
        self._done = 0
        blocks = (-(-height // 16), -(-width // 16))
        luma = (16 * blocks[0], 16 * blocks[1])
        chroma = (luma[0] // 2, luma[1] // 2)
        self._planes = [[_ints(shape) for shape in (luma, chroma, chroma)] for _ in range(3)]
        self._coded = [_ints((h // 4, w // 4)) for h, w in (luma, chroma, chroma)]
        self._small = [_ints((luma[0] // 4, luma[1] // 4)) for _ in range(2)]
        self._vectors, self._known = (_ints((*blocks, 2)) for _ in range(2))
        self._costs, self._bits = _ints(blocks), _ints(blocks)
        self._total = [_ints((1,)) for _ in range(3)]
        self._scale, self._step = (wp.array(table, dtype=wp.int32, device="cpu") for table in (SCALE, STEP))
        self._zigzag = wp.array(ZIGZAG, dtype=wp.int32, device="cpu")
        self._picture = wp.zeros((height, width, 3), dtype=wp.uint8, device="cpu")

    def transcode(self, picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Code the next frame (H, W, 3) uint8 RGB, and return it as decoded."""
        now, before, decoded = self._planes
        source = wp.array(np.ascontiguousarray(picture), dtype=wp.uint8, device="cpu")
        wp.launch(split_colours, now[1].shape, inputs=[source], outputs=now, device="cpu")
        intra = self._done % self._group == 0
        wanted = self._plain_bits * (INTRA_WEIGHT if intra else 1.0)
        wanted = max(wanted - self._owed / self._made_up_in, 0.2 * wanted)
        if not intra:
            for plane, small in zip((now[0], before[0]), self._small, strict=True):
                wp.launch(quarter, small.shape, inputs=[plane], outputs=[small], device="cpu")
            inputs = [now[0], before[0], *self._small, self._known]
            outputs = [self._vectors, self._costs]
            wp.copy(self._known, self._vectors)
            wp.launch(search, self._bits.shape, inputs=inputs, outputs=outputs, device="cpu")
        qp = self.qp
        for _ in range(2):  # a second time where the first guess of the quantiser was poor
            self.bits = self._code(intra, qp)
            off = round(6 * math.log2(max(self.bits, 1) / wanted))
            most = HIGHEST_QP - LOWEST_QP if intra else QUICKEST
            better = min(max(qp + min(max(off, -most), most), LOWEST_QP), HIGHEST_QP)
            if abs(off) <= 2 or better == qp:
                break
            qp = better
        self.qp = qp
        self._owed += self.bits - self._plain_bits * (INTRA_WEIGHT if intra else 1.0)
        self._done += 1
        self._smooth()
        wp.launch(join_colours, self.shape, inputs=decoded, outputs=[self._picture], device="cpu")
        self._planes = [now, decoded, before]
        return np.asarray(self._picture.numpy().copy())

    def _code(self, intra: bool, qp: int) -> int:
        """Code the frame into the decoded planes, and return its size in bits."""
        now, before, decoded = self._planes
        luma, chroma = (self._quantiser(step, intra) for step in (qp, chroma_qp(qp)))
        if intra:
            for plane, q in enumerate((luma, chroma, chroma)):
                outputs = [decoded[plane], self._coded[plane], self._total[plane]]
                wp.launch(code_intra, 1, inputs=[q, now[plane]], outputs=outputs, device="cpu")
            bits = sum(int(total.numpy()[0]) for total in self._total)
        else:
            inputs = [luma, chroma, *now, *before, self._vectors, self._costs]
            outputs = [*decoded, *self._coded, self._bits]
            wp.launch(code_inter, self._bits.shape, inputs=inputs, outputs=outputs, device="cpu")
            bits = int(self._bits.numpy().sum())
        return round(ENTROPY * bits)

    def _quantiser(self, qp: int, intra: bool) -> Quantiser:
        q = Quantiser()
        q.qp, q.intra = qp, int(intra)
        q.scale, q.step, q.zigzag = self._scale, self._step, self._zigzag
        return q

    def _smooth(self) -> None:
        """Apply the loop filter to the decoded planes: vertical edges, then horizontal ones."""
        for plane, coded, side in zip(self._planes[2], self._coded, (16, 8, 8), strict=True):
            qp = self.qp if side == 16 else chroma_qp(self.qp)
            if qp < 16:
                continue
            strength = [ALPHA[qp - 16], BETA[qp - 16], round(0.5 * 2 ** ((qp - 20) / 6))]
            for axis in (1, 0):
                edges = (plane.shape[1 - axis], plane.shape[axis] // 4 - 1)
                wp.launch(deblock, edges, inputs=[plane, coded, side, axis, *strength], device="cpu")


def chroma_qp(qp: int) -> int:
    """Quantiser of the colour differences that goes with a quantiser of luma."""
    return qp if qp < 30 else CHROMA_QP[qp - 30]


def _ints(shape: tuple[int, ...]) -> wp.array:
    return wp.zeros(shape, dtype=wp.int32, device="cpu")
