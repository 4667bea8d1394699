"""The memory of a bay's frames (`ring`): its descriptors and its layout. Without NumPy: the main process makes it."""

import fcntl
import mmap
import os
import stat
from dataclasses import dataclass, replace

SLOTS = 3  # a viewer has the time of two further frames to copy one
PAGE = mmap.PAGESIZE


@dataclass(frozen=True, slots=True)
class RingSpec:
    """All that a process needs to attach, given that it inherited the descriptors."""

    fd: int
    max_megapixels: float
    request_fd: int  # an eventfd: viewers count it up, the writer resets it

    @property
    def fds(self) -> tuple[int, int]:
        return self.fd, self.request_fd

    @property
    def slot_bytes(self) -> int:
        """Header page and pixels, in full pages."""
        pixels = round(self.max_megapixels * 1e6)
        return PAGE + -(-pixels * 3 // PAGE) * PAGE

    @property
    def size_bytes(self) -> int:
        return PAGE + SLOTS * self.slot_bytes

    def offset(self, slot: int) -> int:
        return PAGE + slot * self.slot_bytes

    @staticmethod
    def create(max_megapixels: float) -> "RingSpec":
        """New anonymous memory, to be closed. Its size is sealed, so no process can shrink it under another.

        The writer is given this descriptor: its mode prevents that the memory is opened for writing by another way.
        """
        fd = os.memfd_create("gateway-frames", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
        spec = RingSpec(fd, max_megapixels, os.eventfd(0, os.EFD_CLOEXEC | os.EFD_NONBLOCK))
        os.ftruncate(fd, spec.size_bytes)
        fcntl.fcntl(fd, fcntl.F_ADD_SEALS, fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_GROW | fcntl.F_SEAL_SEAL)
        os.fchmod(fd, stat.S_IRUSR)
        return spec

    def reader(self) -> "RingSpec":
        """The same memory behind a separate descriptor that can't be mapped for writing; the caller closes `fd`."""
        return replace(self, fd=os.open(f"/proc/self/fd/{self.fd}", os.O_RDONLY | os.O_CLOEXEC))

    def close(self) -> None:
        for fd in self.fds:
            os.close(fd)
