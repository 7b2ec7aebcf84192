/* Preloaded: counts calls of the C library on a folder's paths, and fails one or kills the process.
 *
 * Nothing is counted until zd_fault_arm; what a program executes in turn is never armed. Calls on
 * other paths, and allocations, are counted from the first call on the folder on. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <signal.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <unistd.h>

enum { ON_PROJECT = 0, ELSEWHERE = 1, ALLOCATION = 2 };
enum { COUNT = 0, FAIL = 1, KILL = 2 };

static char root[PATH_MAX];
static size_t root_length;
static int armed, what, how, begun, log_fd = -1;
static long at, count;

void zd_fault_arm(const char *folder, int which, int way, long number, int log_to) {
    snprintf(root, sizeof root, "%s", folder);
    root_length = strlen(root);
    what = which;
    how = way;
    at = number;
    log_fd = log_to;
    count = 0;
    begun = 0;
    armed = 1;
}

long zd_fault_count(void) { return count; }

/* Whether this call is the one; errno is set to one of the answers that a disk gives. */
static int strike(const char *name, const char *path, int creates) {
    const long number = __atomic_add_fetch(&count, 1, __ATOMIC_SEQ_CST);
    if (log_fd >= 0) {
        char line[PATH_MAX + 32];
        const int n = snprintf(line, sizeof line, "%s %s\n", name, path);
        (void)!syscall(SYS_write, log_fd, line, (size_t)n);
    }
    if (how == COUNT || number != at) { return 0; }
    if (how == KILL) { syscall(SYS_kill, getpid(), SIGKILL); }
    if (what == ALLOCATION) {
        errno = ENOMEM;
    } else if (strncmp(name, "open", 4) == 0) {
        const int answers[3] = {EIO, EMFILE, creates ? ENOSPC : EIO};
        errno = answers[number % 3];
    } else {
        errno = (number % 2) ? EIO : ENOSPC;
    }
    return 1;
}

static int is_in_root(const char *path) {
    return strncmp(path, root, root_length) == 0 && (path[root_length] == '/' || path[root_length] == 0);
}

/* Whether a call on a path fails now. */
static int meet(const char *name, int folder, const char *path, int creates) {
    char full[2 * PATH_MAX];
    if (armed == 0 || path == NULL) { return 0; }
    if (path[0] != '/') {
        char link[64];
        ssize_t n;
        if (folder == AT_FDCWD) {
            n = syscall(SYS_getcwd, full, (size_t)PATH_MAX) - 1;
        } else {
            snprintf(link, sizeof link, "/proc/self/fd/%d", folder);
            n = syscall(SYS_readlinkat, AT_FDCWD, link, full, (size_t)PATH_MAX);
        }
        if (n < 0) { return 0; }
        snprintf(full + n, sizeof full - (size_t)n, "/%s", path);
        path = full;
    }
    if (is_in_root(path)) {
        begun = 1;
        return (what == ON_PROJECT) ? strike(name, path, creates) : 0;
    }
    if (what != ELSEWHERE || begun == 0 || strncmp(path, "/proc/", 6) == 0) { return 0; }
    if (strncmp(path, "/dev/", 5) == 0 || strncmp(path, "/sys/", 5) == 0) { return 0; }
    return strike(name, path, creates);
}

static int meet_fd(const char *name, int fd) {
    char link[64], full[PATH_MAX];
    ssize_t n;
    if (armed == 0 || fd == log_fd) { return 0; }
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    n = syscall(SYS_readlinkat, AT_FDCWD, link, full, sizeof full - 1);
    if (n <= 0 || full[0] != '/') { return 0; }
    full[n] = 0;
    return meet(name, AT_FDCWD, full, 1);
}

#define NEXT(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))
#define MODE                                                                                       \
    mode_t mode = 0;                                                                               \
    if (flags & (O_CREAT | O_TMPFILE)) {                                                           \
        va_list list;                                                                              \
        va_start(list, flags);                                                                     \
        mode = va_arg(list, mode_t);                                                               \
        va_end(list);                                                                              \
    }
#define OPEN(name)                                                                                 \
    int name(const char *path, int flags, ...) {                                                   \
        MODE return meet("open", AT_FDCWD, path, flags &O_CREAT) ? -1                              \
                                                                 : NEXT(name)(path, flags, mode);  \
    }
#define OPENAT(name)                                                                               \
    int name(int folder, const char *path, int flags, ...) {                                       \
        MODE return meet("open", folder, path, flags &O_CREAT)                                     \
            ? -1                                                                                   \
            : NEXT(name)(folder, path, flags, mode);                                               \
    }
OPEN(open)
OPEN(open64)
OPENAT(openat)
OPENAT(openat64)
#define FOPEN(name)                                                                                \
    FILE *name(const char *path, const char *mode) {                                               \
        return meet("open", AT_FDCWD, path, mode[0] != 'r') ? NULL : NEXT(name)(path, mode);       \
    }
FOPEN(fopen)
FOPEN(fopen64)
ssize_t write(int fd, const void *data, size_t n) {
    return meet_fd("write", fd) ? -1 : NEXT(write)(fd, data, n);
}
ssize_t pwrite64(int fd, const void *data, size_t n, off64_t place) {
    return meet_fd("write", fd) ? -1 : NEXT(pwrite64)(fd, data, n, place);
}
int fsync(int fd) { return meet_fd("fsync", fd) ? -1 : NEXT(fsync)(fd); }
int fdatasync(int fd) { return meet_fd("fsync", fd) ? -1 : NEXT(fdatasync)(fd); }
int ftruncate64(int fd, off64_t n) { return meet_fd("truncate", fd) ? -1 : NEXT(ftruncate64)(fd, n); }
int rename(const char *from, const char *to) {
    return meet("rename", AT_FDCWD, to, 1) ? -1 : NEXT(rename)(from, to);
}
int renameat(int one, const char *from, int other, const char *to) {
    return meet("rename", other, to, 1) ? -1 : NEXT(renameat)(one, from, other, to);
}
int link(const char *from, const char *to) {
    return meet("link", AT_FDCWD, to, 1) ? -1 : NEXT(link)(from, to);
}
int mkdir(const char *path, mode_t mode) {
    return meet("mkdir", AT_FDCWD, path, 1) ? -1 : NEXT(mkdir)(path, mode);
}
int mkdirat(int folder, const char *path, mode_t mode) {
    return meet("mkdir", folder, path, 1) ? -1 : NEXT(mkdirat)(folder, path, mode);
}
int unlink(const char *path) {
    return meet("unlink", AT_FDCWD, path, 0) ? -1 : NEXT(unlink)(path);
}
int unlinkat(int folder, const char *path, int flags) {
    return meet("unlink", folder, path, 0) ? -1 : NEXT(unlinkat)(folder, path, flags);
}
int rmdir(const char *path) { return meet("rmdir", AT_FDCWD, path, 0) ? -1 : NEXT(rmdir)(path); }

/* Allocations of more than 64 KiB: smaller ones fail where no program can say so, and so does the
 * buffer of just that size that an iterator of NumPy 2 makes, which then reads from NULL. */
extern void *__libc_malloc(size_t n);
extern void *__libc_calloc(size_t n, size_t size);
extern void *__libc_realloc(void *old, size_t n);
static int lack(size_t n) {
    char size[32];
    if (!armed || what != ALLOCATION || !begun || n <= 65536u) { return 0; }
    snprintf(size, sizeof size, "%zu bytes", n);
    return strike("malloc", size, 0);
}
void *malloc(size_t n) { return lack(n) ? NULL : __libc_malloc(n); }
void *calloc(size_t n, size_t size) { return lack(n * size) ? NULL : __libc_calloc(n, size); }
void *realloc(void *old, size_t n) { return lack(n) ? NULL : __libc_realloc(old, n); }
