/* Three answers: a call on the list passes; a call that only an attacker makes kills the process, so that the daemon can tell the
 * operator (SIGSYS); any other fails with EPERM, which a library that merely looks around survives. */
#include "server/worker/jail_filter.h"

#include <errno.h>
#include <fcntl.h>
#include <sched.h>
#include <seccomp.h>
#include <stdio.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <unistd.h>

#if defined(__has_feature)
#if __has_feature(address_sanitizer)
#define SANITIZED 1
#endif
#endif
#ifndef SANITIZED
#define SANITIZED 0
#endif

#define CALL(name) SCMP_SYS(name)

/* Whatever their arguments. What a path may reach is Landlock's matter (openat, rename, unlink, mkdir), not this filter's. */
static const int kAllowed[] = {
    /* files that are open, and files beneath the output folder */
    CALL(read),
    CALL(write),
    CALL(readv),
    CALL(writev),
    CALL(pread64),
    CALL(pwrite64),
    CALL(lseek),
    CALL(close),
    CALL(fstat),
    CALL(newfstatat),
    CALL(open),
    CALL(openat),
    CALL(mkdir),
    CALL(mkdirat),
    CALL(rename),
    CALL(renameat),
    CALL(renameat2),
    CALL(unlink),
    CALL(unlinkat),
    CALL(rmdir),
    CALL(ftruncate),
    CALL(fallocate),
    CALL(fsync),
    CALL(fdatasync),
    CALL(sync_file_range),
    CALL(getdents64),
    /* memory */
    CALL(brk),
    CALL(munmap),
    CALL(mremap),
    CALL(madvise),
    CALL(msync),
    CALL(mincore),
    /* threads and time */
    CALL(futex),
    CALL(set_robust_list),
    CALL(get_robust_list),
    CALL(rseq),
    CALL(set_tid_address),
    CALL(sched_yield),
    CALL(sched_getaffinity),
    CALL(clock_gettime),
    CALL(clock_getres),
    CALL(clock_nanosleep),
    CALL(nanosleep),
    CALL(gettimeofday),
    CALL(time),
    CALL(getrandom),
    CALL(poll),
    CALL(ppoll),
#if SANITIZED
    /* UBSan looks through a pipe whether memory can be read */
    CALL(pipe),
    CALL(pipe2),
#endif
    /* itself */
    CALL(getpid),
    CALL(gettid),
    CALL(getuid),
    CALL(geteuid),
    CALL(getgid),
    CALL(getegid),
    CALL(getrusage),
    CALL(getrlimit),
    CALL(sysinfo),
    CALL(uname),
    CALL(rt_sigaction),
    CALL(rt_sigprocmask),
    CALL(rt_sigreturn),
    CALL(sigaltstack),
    CALL(restart_syscall),
    CALL(exit),
    CALL(exit_group),
};

static const int kDeadly[] = {
    CALL(execve),
    CALL(execveat),
    CALL(ptrace),
    CALL(process_vm_readv),
    CALL(process_vm_writev),
    CALL(bpf),
    CALL(mount),
    CALL(umount2),
    CALL(pivot_root),
    CALL(chroot),
    CALL(setns),
    CALL(unshare),
    CALL(init_module),
    CALL(finit_module),
    CALL(kexec_load),
    CALL(add_key),
    CALL(keyctl),
    CALL(request_key),
    CALL(perf_event_open),
    CALL(userfaultfd),
    CALL(io_uring_setup),
    CALL(connect),
    CALL(bind),
    CALL(listen),
};

#define THREAD_FLAGS (CLONE_VM | CLONE_FS | CLONE_FILES | CLONE_SIGHAND | CLONE_THREAD)
#define NEW_NAMESPACES (CLONE_NEWNS | CLONE_NEWCGROUP | CLONE_NEWUTS | CLONE_NEWIPC | CLONE_NEWUSER | CLONE_NEWPID | CLONE_NEWNET)

/* seccomp.h's own macros leave a member out, which clang warns of. */
#define EQUALS(argument, value)                                                                                                            \
  { (argument), SCMP_CMP_EQ, (value), 0 }
#define MASKED(argument, mask, value)                                                                                                      \
  { (argument), SCMP_CMP_MASKED_EQ, (mask), (value) }

/* A call that passes only with certain arguments. Several rows of one call are alternatives. */
struct conditional {
  int call;
  unsigned count;
  struct scmp_arg_cmp conditions[2];
};

static int add_conditional(scmp_filter_ctx filter) {
  const scmp_datum_t self = (scmp_datum_t)getpid();
  const struct conditional rows[] = {
      /* new threads, no new processes. clone3 hides its flags in memory, where a filter cannot look: ENOSYS below sends glibc to clone */
      {CALL(clone), 1, {MASKED(0, THREAD_FLAGS | NEW_NAMESPACES, THREAD_FLAGS)}},
      /* nothing becomes executable any more */
      {CALL(mmap), 1, {MASKED(2, PROT_EXEC, 0)}},
      {CALL(mprotect), 1, {MASKED(2, PROT_EXEC, 0)}},
      /* signals to itself: abort() and timers of its own */
      {CALL(kill), 1, {EQUALS(0, self)}},
      {CALL(tgkill), 1, {EQUALS(0, self)}},
      /* fcntl without F_SETOWN and leases, which send signals */
      {CALL(fcntl), 1, {EQUALS(1, F_GETFD)}},
      {CALL(fcntl), 1, {EQUALS(1, F_SETFD)}},
      {CALL(fcntl), 1, {EQUALS(1, F_GETFL)}},
      {CALL(fcntl), 1, {EQUALS(1, F_SETFL)}},
      {CALL(fcntl), 1, {EQUALS(1, F_DUPFD_CLOEXEC)}},
      /* send() on the socket that is connected already: no address */
      {CALL(sendto), 2, {EQUALS(4, 0), EQUALS(5, 0)}},
      /* limits may be read, of itself */
      {CALL(prlimit64), 2, {EQUALS(0, 0), EQUALS(2, 0)}},
      /* threads' names, and what the jail reads back */
      {CALL(prctl), 1, {EQUALS(0, PR_SET_NAME)}},
      {CALL(prctl), 1, {EQUALS(0, PR_GET_NAME)}},
      {CALL(prctl), 1, {EQUALS(0, PR_GET_SECCOMP)}},
      {CALL(prctl), 1, {EQUALS(0, PR_GET_NO_NEW_PRIVS)}},
      {CALL(prctl), 1, {EQUALS(0, PR_GET_DUMPABLE)}},
  };
  int code = 0;
  for (size_t i = 0; code == 0 && i < sizeof rows / sizeof rows[0]; i++)
    code = seccomp_rule_add_array(filter, SCMP_ACT_ALLOW, rows[i].call, rows[i].count, rows[i].conditions);
  return code;
}

static int add_list(scmp_filter_ctx filter, uint32_t action, const int *calls, size_t count) {
  int code = 0;
  for (size_t i = 0; code == 0 && i < count; i++) {
    code = seccomp_rule_add(filter, action, calls[i], 0);
    if (code == -EDOM) /* this architecture has no such call (open, rename on arm64) */
      code = 0;
  }
  return code;
}

bool lod_jail_filter_load(char *why, size_t size) {
  scmp_filter_ctx filter = seccomp_init(SCMP_ACT_ERRNO(EPERM));
  if (filter == NULL) {
    snprintf(why, size, "no memory for the filter");
    return false;
  }
  int code = seccomp_attr_set(filter, SCMP_FLTATR_CTL_TSYNC, 1); /* all threads, should a library have started one */
  if (code == 0)
    code = seccomp_attr_set(filter, SCMP_FLTATR_CTL_OPTIMIZE, 2); /* a binary tree: cheap also for calls at the end of the list */
  if (code == 0)
    code = add_list(filter, SCMP_ACT_ALLOW, kAllowed, sizeof kAllowed / sizeof kAllowed[0]);
  if (code == 0)
    code = add_list(filter, SCMP_ACT_KILL_PROCESS, kDeadly, sizeof kDeadly / sizeof kDeadly[0]);
  if (code == 0)
    code = add_conditional(filter);
  if (code == 0)
    code = seccomp_rule_add(filter, SCMP_ACT_ERRNO(ENOSYS), CALL(clone3), 0);
  if (code == 0)
    code = seccomp_load(filter);
  seccomp_release(filter);
  if (code != 0)
    snprintf(why, size, "the filter is refused: %s", strerror(-code));
  return code == 0;
}
