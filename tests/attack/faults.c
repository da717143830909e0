/* One failure of the k-th system call on files under a prefix: preload, then call fault_arm. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <stdarg.h>
#include <stddef.h>
#include <string.h>
#include <sys/types.h>

#define MOST 65536
static char prefix[4096];
static size_t length;
static long target, seen;
static unsigned char watched[MOST];

/* Calls on files under `path` are counted from now on; the `k`-th fails. An empty path: none. */
void fault_arm(const char *path, long k) {
    length = 0;
    strncpy(prefix, path, sizeof prefix - 1);
    memset(watched, 0, sizeof watched);
    target = k;
    seen = 0;
    length = strlen(prefix);
}

long fault_seen(void) { return seen; }

static int under(const char *path) { return length && path && !strncmp(path, prefix, length); }
static int strikes(int error) {
    if (__sync_add_and_fetch(&seen, 1) != target) return 0;
    errno = error;
    return 1;
}
static int on_watched(int fd, int error) { return fd >= 0 && fd < MOST && watched[fd] && strikes(error); }
static int opened(int fd, const char *path) {
    if (fd >= 0 && fd < MOST) watched[fd] = under(path);
    return fd;
}

#define REAL(type, name, ...) \
    static type (*real)(__VA_ARGS__); \
    if (!real) real = (type(*)(__VA_ARGS__))dlsym(RTLD_NEXT, name)

#define MODE mode_t mode = 0; if (flags & (O_CREAT | O_TMPFILE)) { va_list a; va_start(a, flags); mode = va_arg(a, int); va_end(a); }
#define OPEN(name) int name(const char *path, int flags, ...) { \
    REAL(int, #name, const char *, int, ...); MODE \
    return under(path) && strikes(EIO) ? -1 : opened(real(path, flags, mode), path); }
#define OPENAT(name) int name(int at, const char *path, int flags, ...) { \
    REAL(int, #name, int, const char *, int, ...); MODE \
    return under(path) && strikes(EIO) ? -1 : opened(real(at, path, flags, mode), path); }
OPEN(open) OPEN(open64) OPENAT(openat) OPENAT(openat64)

int close(int fd) {
    REAL(int, "close", int);
    if (fd >= 0 && fd < MOST) watched[fd] = 0;
    return real(fd);
}
#define MOVE(name, data) ssize_t name(int fd, data buffer, size_t n) { \
    REAL(ssize_t, #name, int, data, size_t); return on_watched(fd, EIO) ? -1 : real(fd, buffer, n); }
#define MOVE_AT(name, data, place) ssize_t name(int fd, data buffer, size_t n, place at) { \
    REAL(ssize_t, #name, int, data, size_t, place); return on_watched(fd, EIO) ? -1 : real(fd, buffer, n, at); }
MOVE(read, void *) MOVE(write, const void *)
MOVE_AT(pread, void *, off_t) MOVE_AT(pread64, void *, off64_t)
MOVE_AT(pwrite, const void *, off_t) MOVE_AT(pwrite64, const void *, off64_t)
#define SYNC(name) int name(int fd) { REAL(int, #name, int); return on_watched(fd, EIO) ? -1 : real(fd); }
SYNC(fsync) SYNC(fdatasync)
int rename(const char *a, const char *b) {
    REAL(int, "rename", const char *, const char *);
    return under(b) && strikes(EIO) ? -1 : real(a, b);
}
int unlink(const char *path) {
    REAL(int, "unlink", const char *);
    return under(path) && strikes(EIO) ? -1 : real(path);
}
