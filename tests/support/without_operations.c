/* Put before libc: what some file systems do not have. No locks, no flush of folders, no links, no modes and times, no
   allocation ahead, no size, no copy inside. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <sys/stat.h>
#include <sys/statvfs.h>
#include <unistd.h>

static int missing(int code) {
    errno = code;
    return -1;
}

int flock(int file, int how) { (void)file, (void)how; return missing(ENOSYS); }
int link(const char *from, const char *to) { (void)from, (void)to; return missing(EPERM); }
int symlink(const char *from, const char *to) { (void)from, (void)to; return missing(EPERM); }
int chmod(const char *path, mode_t mode) { (void)path, (void)mode; return missing(EPERM); }
int fchmod(int file, mode_t mode) { (void)file, (void)mode; return missing(EPERM); }
int futimens(int file, const struct timespec times[2]) { (void)file, (void)times; return missing(ENOSYS); }
int posix_fallocate(int file, off_t from, off_t length) { (void)file, (void)from, (void)length; return EOPNOTSUPP; }
int statvfs(const char *path, struct statvfs *found) { (void)path, (void)found; return missing(ENOSYS); }
int statvfs64(const char *path, struct statvfs64 *found) { (void)path, (void)found; return missing(ENOSYS); }

int fsync(int file) {
    struct stat found;
    if (fstat(file, &found) == 0 && S_ISDIR(found.st_mode)) return missing(EINVAL);
    return ((int (*)(int))dlsym(RTLD_NEXT, "fsync"))(file);
}
