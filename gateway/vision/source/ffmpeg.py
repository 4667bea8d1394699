"""The one place where FFmpeg is given something to decode, and what it may take it for.

FFmpeg knows hundreds of containers and codecs, and selects one by the content: without these lists a device on the
network would select the weakest of them, and a playlist would make it open other addresses and files. In a file of
this machine any codec is decoded.
"""

import os
from collections.abc import Sequence
from typing import Any

import cv2
from numpy.typing import NDArray

OPTIONS = "OPENCV_FFMPEG_CAPTURE_OPTIONS"  # read by OpenCV when it opens; set, it replaces OpenCV's own default
CODECS = {"h264": "h264", "hevc": "hevc", "MJPG": "mjpeg", "FMP4": "mpeg4"}  # OpenCV's name, FFmpeg's
MOST_DAMAGED = 10  # frames in a row that can't be decoded: there is no other
NETWORK = {
    # Without `nobuffer` and `low_delay` FFmpeg holds back several frames.
    "rtsp_transport": "tcp",
    "fflags": "nobuffer",
    "flags": "low_delay",
    "format_whitelist": "rtsp,sdp,rtp,mpegts,mpjpeg,mjpeg,jpeg_pipe,h264,hevc",
    "protocol_whitelist": "rtsp,rtsps,rtp,udp,tcp,tls,http,https",
    "codec_whitelist": ",".join(CODECS.values()),  # of FFmpeg's look at the stream; OpenCV's decoder ignores it
}
FILE = {
    "format_whitelist": "avi,mov,matroska,webm,mp4,m4v,mpegts,mpeg,mpegvideo,mpjpeg,mjpeg,h264,hevc,flv,asf,ogg,gif",
    "protocol_whitelist": "file",
}


def opened(target: str, options: dict[str, str], parameters: Sequence[int] = ()) -> cv2.VideoCapture:
    """It may not have opened. What an operator's own OPENCV_FFMPEG_CAPTURE_OPTIONS name wins (RTSP over UDP, say)."""
    own = os.environ.get(OPTIONS)
    named = {part.partition(";")[0] for part in (own or "").split("|")}
    parts = [f"{key};{value}" for key, value in options.items() if key not in named]
    os.environ[OPTIONS] = "|".join(([own] if own else []) + parts)
    try:
        return cv2.VideoCapture(target, cv2.CAP_FFMPEG, parameters)
    finally:
        if own is None:
            del os.environ[OPTIONS]
        else:
            os.environ[OPTIONS] = own


def read(capture: cv2.VideoCapture) -> tuple[NDArray[Any] | None, int]:
    """The next frame of a film that can be decoded, and how many before it can't be; None: there is no other."""
    for damaged in range(MOST_DAMAGED):
        done, image = capture.read()
        if done:
            return image, damaged
    return None, 0


def codec_of(capture: cv2.VideoCapture) -> str:
    """Before anything is decoded: a key of CODECS, or another FourCC."""
    return int(capture.get(cv2.CAP_PROP_FOURCC)).to_bytes(4, "little", signed=True).decode("ascii", "replace")
