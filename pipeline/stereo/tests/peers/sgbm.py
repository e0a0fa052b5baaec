"""Disparities of rectified pairs by OpenCV's SGBM. Called by the test `side_by_side` and the example `held_out` with groups
of LEFT.png RIGHT.png DISPARITIES ROWS OUT; the right eye shows everything ROWS pixels lower; OUT becomes float32 pixels of
the left eye, row-major, NaN where unknown.

Settings are OpenCV's usual ones for its 5x5 blocks (P1 = 8 * 25, P2 = 32 * 25), all eight paths, its own left-right check,
uniqueness of 10 % and specks of 100 pixels."""
import sys

import cv2
import numpy as np

BLOCK = 5


def matcher(disparities):
    """The matcher for so many disparities, rounded up to the multiple of 16 that OpenCV asks for."""
    return cv2.StereoSGBM_create(
        minDisparity=0,
        numDisparities=(int(disparities) + 15) // 16 * 16,
        blockSize=BLOCK,
        P1=8 * BLOCK * BLOCK,
        P2=32 * BLOCK * BLOCK,
        disp12MaxDiff=1,
        preFilterCap=63,
        uniquenessRatio=10,
        speckleWindowSize=100,
        speckleRange=2,
        mode=cv2.STEREO_SGBM_MODE_HH,
    )


def main(arguments):
    for left, right, disparities, rows, out in zip(*[iter(arguments)] * 5):
        left, right = (cv2.imread(path, cv2.IMREAD_GRAYSCALE) for path in (left, right))
        if float(rows):
            move, size = np.float32([[1, 0, 0], [0, 1, -float(rows)]]), right.shape[::-1]
            right = cv2.warpAffine(right, move, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        found = matcher(disparities).compute(left, right).astype(np.float32) / 16
        found[found <= 0] = np.nan
        found.tofile(out)


if __name__ == "__main__":
    main(sys.argv[1:])
