/* Stands before libc (LD_PRELOAD). While the file $SHIM_WHEN is there:
 *   SHIM=clock  the clock is ten days back;
 *   SHIM=share  what is done below $SHIM_BELOW fails: ESTALE, EIO and ETIMEDOUT in turn.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

#define BACK 864000
#define REAL(name) static __typeof__(name) *real; if (!real) real = dlsym(RTLD_NEXT, #name)

static int now(const char *fault) {
    const char *which = getenv("SHIM"), *when = getenv("SHIM_WHEN");
    if (!which || !when || strcmp(which, fault)) return 0;
    int kept = errno, there = syscall(SYS_access, when, F_OK) == 0;
    errno = kept;
    return there;
}

static int fails(const char *path) {
    static const int answers[] = {ESTALE, EIO, ETIMEDOUT};
    static int turn;
    const char *below = getenv("SHIM_BELOW");
    if (!below || !path || strncmp(path, below, strlen(below)) || !now("share")) return 0;
    errno = answers[__sync_fetch_and_add(&turn, 1) % 3];
    return 1;
}

static int fails_of(int file) {
    char link[64], path[4096];
    if (!getenv("SHIM_BELOW")) return 0;
    snprintf(link, sizeof link, "/proc/self/fd/%d", file);
    ssize_t n = readlink(link, path, sizeof path - 1);
    if (n < 0) return 0;
    path[n] = 0;
    return fails(path);
}

int clock_gettime(clockid_t clock, struct timespec *at) {
    REAL(clock_gettime);
    int status = real(clock, at);
    if (!status && clock == CLOCK_REALTIME && now("clock")) at->tv_sec -= BACK;
    return status;
}

time_t time(time_t *to) {
    struct timespec at;
    clock_gettime(CLOCK_REALTIME, &at);
    if (to) *to = at.tv_sec;
    return at.tv_sec;
}

int gettimeofday(struct timeval *at, void *zone) {
    struct timespec exact;
    clock_gettime(CLOCK_REALTIME, &exact);
    (void)zone;
    at->tv_sec = exact.tv_sec;
    at->tv_usec = exact.tv_nsec / 1000;
    return 0;
}

#define OPEN(name) \
    int name(const char *path, int flags, ...) { \
        REAL(name); \
        va_list rest; \
        va_start(rest, flags); \
        mode_t mode = va_arg(rest, mode_t); \
        va_end(rest); \
        return fails(path) ? -1 : real(path, flags, mode); \
    }
OPEN(open)
OPEN(open64)

#define OF_PATH(name, rest, call) \
    int name(const char *path rest) { REAL(name); return fails(path) ? -1 : real call; }
#define COMMA ,
OF_PATH(rename, COMMA const char *to, (path, to))
OF_PATH(mkdir, COMMA mode_t mode, (path, mode))
OF_PATH(unlink, , (path))
OF_PATH(stat, COMMA struct stat *to, (path, to))

#define OF_FILE(type, name, rest, call) \
    type name(int file rest) { REAL(name); return fails_of(file) ? -1 : real call; }
OF_FILE(ssize_t, write, COMMA const void *b COMMA size_t n, (file, b, n))
OF_FILE(ssize_t, read, COMMA void *b COMMA size_t n, (file, b, n))
OF_FILE(ssize_t, pwrite, COMMA const void *b COMMA size_t n COMMA off_t o, (file, b, n, o))
OF_FILE(ssize_t, pwrite64, COMMA const void *b COMMA size_t n COMMA off64_t o, (file, b, n, o))
OF_FILE(int, fsync, , (file))
