/* Faults at numbered system calls, for `egotac bench faults`: preloaded into the program under test (x86-64 Linux).
 *
 * EGOTAC_FAULT = KINDS:NUMBER:ACTION:SPAN
 *   KINDS   comma separated: write, sync, rename, create, remove, read; calls of these kinds are numbered together
 *   NUMBER  first call that the fault hits, from 1; 0 = only count
 *   ACTION  "kill", "stop", or the number of an error
 *   SPAN    "once", or "on": later calls fail too
 * EGOTAC_FAULT_BELOW = folder whose files count
 * EGOTAC_FAULT_COUNTS = file of counts (struct counts), shared by all processes of the program
 *
 * Changing calls are trapped by a seccomp filter, as some libraries make them without libc. A filter outlives exec, and
 * the loader of a new program opens and reads files before this library is there; so reads are replaced symbols.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <linux/audit.h>
#include <linux/filter.h>
#include <linux/seccomp.h>
#include <signal.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <ucontext.h>
#include <unistd.h>

enum kind { WRITE, SYNC, RENAME, CREATE, REMOVE, READ, KINDS };
static const char *const NAMES[KINDS] = {"write", "sync", "rename", "create", "remove", "read"};

/* Read by inject.rs. */
struct counts {
    uint32_t calls[KINDS]; /* calls of each kind */
    uint32_t numbered;     /* calls of the fault's kinds */
    uint32_t hits;         /* calls that the fault hit */
};

/* In the sixth argument, which none of the trapped calls has, it tells the filter that the call is the handler's own. */
#define OWN 0x65676f74

static struct counts *counts;
static const char *below;
static size_t below_length;
static unsigned mask;
static uint32_t number;
static int action; /* error number, or a negative signal */
static int goes_on;

static long call(long nr, long a, long b, long c, long d, long e) {
    long result;
    register long r10 __asm__("r10") = d;
    register long r8 __asm__("r8") = e;
    register long r9 __asm__("r9") = OWN;
    __asm__ volatile("syscall"
                     : "=a"(result)
                     : "a"(nr), "D"(a), "S"(b), "d"(c), "r"(r10), "r"(r8), "r"(r9)
                     : "rcx", "r11", "memory");
    return result;
}

static int is_below(const char *path) {
    return !strncmp(path, below, below_length) && (path[below_length] == '/' || path[below_length] == 0);
}

/* Path of an open file; a file that is deleted keeps its path. */
static int fd_is_below(int fd) {
    char link[32] = "/proc/self/fd/", target[4096];
    char digits[12];
    int n = 0;
    if (fd == AT_FDCWD) {
        strcpy(link, "/proc/self/cwd");
    } else {
        if (fd < 0)
            return 0;
        do
            digits[n++] = (char)('0' + fd % 10);
        while ((fd /= 10) > 0);
        char *end = link + strlen(link);
        while (n > 0)
            *end++ = digits[--n];
        *end = 0;
    }
    long length = call(SYS_readlink, (long)link, (long)target, sizeof target - 1, 0, 0);
    if (length <= 0)
        return 0;
    target[length] = 0;
    return is_below(target);
}

static int path_is_below(int folder, const char *path) {
    if (path[0] == '/')
        return is_below(path);
    if (fd_is_below(folder))
        return 1;
    /* A folder above `below`: the path may lead down into it. */
    char target[8192];
    long length;
    if (folder != AT_FDCWD)
        return 0;
    length = call(SYS_readlink, (long)"/proc/self/cwd", (long)target, 4095, 0, 0);
    if (length <= 0 || strlen(path) > 4000)
        return 0;
    while (path[0] == '.' && path[1] == '/')
        path += 2;
    target[length++] = '/';
    strcpy(target + length, path);
    return is_below(target);
}

/* Counts a call; the error that it is to fail with, or 0. */
static int fault(enum kind kind) {
    __atomic_add_fetch(&counts->calls[kind], 1, __ATOMIC_SEQ_CST);
    if (!(mask & 1u << kind))
        return 0;
    uint32_t n = __atomic_add_fetch(&counts->numbered, 1, __ATOMIC_SEQ_CST);
    if (number == 0 || n < number || (n > number && !goes_on))
        return 0;
    __atomic_add_fetch(&counts->hits, 1, __ATOMIC_SEQ_CST);
    if (action > 0)
        return action;
    kill(getpid(), -action);
    return 0;
}

static int trapped(int nr, const long *a) {
    if (!counts)
        return nr == SYS_copy_file_range ? ENOSYS : 0;
    switch (nr) {
    case SYS_write: case SYS_pwrite64: case SYS_writev: case SYS_pwritev: case SYS_ftruncate: case SYS_fallocate:
    case SYS_sendfile:
        return fd_is_below((int)a[0]) ? fault(WRITE) : 0;
    case SYS_copy_file_range:
        return ENOSYS; /* It has six arguments; callers then read and write. */
    case SYS_fsync: case SYS_fdatasync:
        return fd_is_below((int)a[0]) ? fault(SYNC) : 0;
    case SYS_rename: case SYS_link:
        return path_is_below(AT_FDCWD, (const char *)a[1]) ? fault(RENAME) : 0;
    case SYS_renameat: case SYS_renameat2: case SYS_linkat:
        return path_is_below((int)a[2], (const char *)a[3]) ? fault(RENAME) : 0;
    case SYS_open: case SYS_mkdir: case SYS_symlink:
        return path_is_below(AT_FDCWD, (const char *)a[nr == SYS_symlink]) ? fault(CREATE) : 0;
    case SYS_openat: case SYS_mkdirat:
        return path_is_below((int)a[0], (const char *)a[1]) ? fault(CREATE) : 0;
    case SYS_unlink: case SYS_rmdir:
        return path_is_below(AT_FDCWD, (const char *)a[0]) ? fault(REMOVE) : 0;
    case SYS_unlinkat:
        return path_is_below((int)a[0], (const char *)a[1]) ? fault(REMOVE) : 0;
    }
    return 0;
}

static void on_trap(int signal, siginfo_t *info, void *context) {
    (void)signal;
    greg_t *r = ((ucontext_t *)context)->uc_mcontext.gregs;
    long a[5] = {r[REG_RDI], r[REG_RSI], r[REG_RDX], r[REG_R10], r[REG_R8]};
    int error = trapped(info->si_syscall, a);
    r[REG_RAX] = error ? -error : call(info->si_syscall, a[0], a[1], a[2], a[3], a[4]);
}

#define LOAD(field) BPF_STMT(BPF_LD | BPF_W | BPF_ABS, (uint32_t)offsetof(struct seccomp_data, field))
#define TRAP(nr) BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, nr, 0, 1), BPF_STMT(BPF_RET | BPF_K, SECCOMP_RET_TRAP)
#define ALLOW BPF_STMT(BPF_RET | BPF_K, SECCOMP_RET_ALLOW)
#define CHANGES (O_WRONLY | O_RDWR | O_CREAT | O_TRUNC)

static int trap_changes(void) {
    struct sock_filter code[] = {
        LOAD(arch),
        BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, AUDIT_ARCH_X86_64, 1, 0),
        ALLOW,
        LOAD(args[5]),
        BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, OWN, 0, 1),
        ALLOW,
        LOAD(nr),
        TRAP(SYS_write), TRAP(SYS_pwrite64), TRAP(SYS_writev), TRAP(SYS_pwritev), TRAP(SYS_ftruncate),
        TRAP(SYS_fallocate), TRAP(SYS_sendfile), TRAP(SYS_copy_file_range), TRAP(SYS_fsync), TRAP(SYS_fdatasync),
        TRAP(SYS_rename), TRAP(SYS_renameat), TRAP(SYS_renameat2), TRAP(SYS_link), TRAP(SYS_linkat), TRAP(SYS_mkdir),
        TRAP(SYS_mkdirat), TRAP(SYS_symlink), TRAP(SYS_unlink), TRAP(SYS_rmdir), TRAP(SYS_unlinkat),
        /* Opening to read is not trapped: the loader of a new program does so before the handler is there. */
        BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, SYS_openat, 0, 4),
        LOAD(args[2]),
        BPF_JUMP(BPF_JMP | BPF_JSET | BPF_K, CHANGES, 0, 1),
        BPF_STMT(BPF_RET | BPF_K, SECCOMP_RET_TRAP),
        ALLOW,
        BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, SYS_open, 0, 3),
        LOAD(args[1]),
        BPF_JUMP(BPF_JMP | BPF_JSET | BPF_K, CHANGES, 0, 1),
        BPF_STMT(BPF_RET | BPF_K, SECCOMP_RET_TRAP),
        ALLOW,
    };
    struct sock_fprog filter = {sizeof code / sizeof code[0], code};
    return !prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) && !prctl(PR_SET_SECCOMP, SECCOMP_MODE_FILTER, &filter, 0, 0);
}

/* An exit status that no program under test has. */
static void refuse(void) {
    _exit(99);
}

__attribute__((constructor)) static void start(void) {
    const char *settings = getenv("EGOTAC_FAULT"), *path = getenv("EGOTAC_FAULT_COUNTS");
    below = getenv("EGOTAC_FAULT_BELOW");
    if (!settings || !path || !below)
        return;
    below_length = strlen(below);
    /* First: a program that was started by one under test has that one's filter already. */
    struct sigaction handler = {.sa_sigaction = on_trap, .sa_flags = SA_SIGINFO | SA_NODEFER | SA_RESTART};
    if (sigaction(SIGSYS, &handler, NULL))
        refuse();
    char text[256];
    if (strlen(settings) >= sizeof text)
        refuse();
    strcpy(text, settings);
    char *rest = text, *kinds = strsep(&rest, ":"), *at = strsep(&rest, ":"), *what = strsep(&rest, ":");
    if (!at || !what || !rest)
        refuse();
    for (char *name; (name = strsep(&kinds, ","));)
        for (int kind = 0; kind < KINDS; kind++)
            if (!strcmp(name, NAMES[kind]))
                mask |= 1u << kind;
    number = (uint32_t)strtoul(at, NULL, 10);
    action = !strcmp(what, "kill") ? -SIGKILL : !strcmp(what, "stop") ? -SIGSTOP : atoi(what);
    goes_on = !strcmp(rest, "on");
    int fd = open(path, O_RDWR | O_CLOEXEC);
    void *memory = fd < 0 ? MAP_FAILED : mmap(NULL, sizeof *counts, PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
    if (memory == MAP_FAILED)
        refuse();
    close(fd);
    counts = memory;
    if (!trap_changes())
        refuse();
}

#define READS(result, name, parameters, arguments)                                                                     \
    result name parameters {                                                                                           \
        static result(*next) parameters;                                                                               \
        if (!next)                                                                                                     \
            *(void **)&next = dlsym(RTLD_NEXT, #name);                                                                 \
        int error = counts && (mask & 1u << READ) && fd_is_below(fd) ? fault(READ) : 0;                                \
        if (error) {                                                                                                   \
            errno = error;                                                                                             \
            return -1;                                                                                                 \
        }                                                                                                              \
        return next arguments;                                                                                         \
    }
READS(ssize_t, read, (int fd, void *to, size_t size), (fd, to, size))
READS(ssize_t, readv, (int fd, const struct iovec *to, int n), (fd, to, n))
READS(ssize_t, pread, (int fd, void *to, size_t size, off_t at), (fd, to, size, at))
READS(ssize_t, pread64, (int fd, void *to, size_t size, off64_t at), (fd, to, size, at))
