"""A file system that does not tell capitals, over a folder of one that does: for tests and programs by hand.

    pip install fusepy                                     # and the library libfuse 2
    python3 tests/support/case_insensitive.py FOLDER MOUNT &
    TMPDIR=MOUNT cargo test -p rogs-files                  # or any program below MOUNT
    fusermount -u MOUNT

Names keep the capitals that they were made with, as on macOS and Windows.
"""

import errno
import os
import sys

from fuse import FUSE, FuseOSError, Operations

ATTRIBUTES = ["st_mode", "st_nlink", "st_size", "st_uid", "st_gid", "st_ino", "st_blocks"]
TIMES = ["st_atime", "st_mtime", "st_ctime"]
SPACE = ["f_bavail", "f_bfree", "f_blocks", "f_bsize", "f_favail", "f_ffree", "f_files", "f_frsize", "f_namemax"]


class Folded(Operations):
    use_ns = True

    def __init__(self, root):
        self.root = root

    def place(self, path):
        """Where a path lies: every part is what has its name, or else its name in other capitals."""
        here = self.root
        for part in filter(None, path.split("/")):
            there = os.path.join(here, part)
            if not os.path.lexists(there) and os.path.isdir(here):
                alike = [name for name in os.listdir(here) if name.lower() == part.lower()]
                there = os.path.join(here, alike[0]) if alike else there
            here = there
        return here

    def access(self, path, mode):
        if not os.access(self.place(path), mode):
            raise FuseOSError(errno.EACCES)

    def getattr(self, path, handle=None):
        found = os.lstat(self.place(path))
        return {name: getattr(found, name) for name in ATTRIBUTES} | {
            name: getattr(found, name + "_ns") for name in TIMES
        }

    def rename(self, old, new):
        source, target = self.place(old), self.place(new)
        if source == target:
            target = os.path.join(os.path.dirname(target), os.path.basename(new))
        os.rename(source, target)

    def statfs(self, path):
        found = os.statvfs(self.place(path))
        return {name: getattr(found, name) for name in SPACE}

    def truncate(self, path, length, handle=None):
        os.truncate(self.place(path), length)

    def utimens(self, path, times=None):
        os.utime(self.place(path), ns=times)

    def readdir(self, path, handle):
        return [".", "..", *os.listdir(self.place(path))]

    def readlink(self, path):
        return os.readlink(self.place(path))

    def mkdir(self, path, mode):
        os.mkdir(self.place(path), mode)

    def mknod(self, path, mode, device):
        os.mknod(self.place(path), mode, device)

    def rmdir(self, path):
        os.rmdir(self.place(path))

    def unlink(self, path):
        os.unlink(self.place(path))

    def symlink(self, name, target):
        os.symlink(target, self.place(name))

    def link(self, name, target):
        os.link(self.place(target), self.place(name))

    def chmod(self, path, mode):
        os.chmod(self.place(path), mode)

    def chown(self, path, user, group):
        os.chown(self.place(path), user, group)

    def open(self, path, flags):
        return os.open(self.place(path), flags & ~os.O_APPEND)

    def create(self, path, mode, info=None):
        return os.open(self.place(path), os.O_RDWR | os.O_CREAT, mode)

    def read(self, path, size, offset, handle):
        return os.pread(handle, size, offset)

    def write(self, path, data, offset, handle):
        return os.pwrite(handle, data, offset)

    def fsync(self, path, only_data, handle):
        os.fsync(handle)

    def release(self, path, handle):
        os.close(handle)


if __name__ == "__main__":
    FUSE(Folded(os.path.abspath(sys.argv[1])), sys.argv[2], foreground=True, nothreads=True)
