"""What the codes of `Rejection.why` mean, of every method, in one place."""

from gateway.vision.detect.robust.rejections import REJECTION_MEANING

REASONS: dict[str, str] = dict(REJECTION_MEANING)
