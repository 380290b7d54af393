/* The jail: what a bake needs goes on, and each thing that a hostile model might make the worker do is stopped. Every attempt runs in a
 * child of its own, jailed for good; the program prints the table of what was tried and what stopped it. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>

#include <arpa/inet.h>
#include <errno.h>
#include <fcntl.h>
#include <netinet/in.h>
#include <pthread.h>
#include <sched.h>
#include <seccomp.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/ptrace.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include "core/base/parallel.h"
#include "server/jobs/frame.h"
#include "server/store/files.h"
#include "server/worker/jail.h"

#if defined(__has_feature)
#if __has_feature(address_sanitizer)
#define SANITIZED 1
#endif
#endif
#ifndef SANITIZED
#define SANITIZED 0
#endif

struct fixture {
  char root[64];
  int output_fd, secret_fd, sockets[2];
  pid_t victim; /* a process of the same user */
  struct sockaddr_in server;
  int server_fd;
};

static int set_up(void **state) {
  struct fixture *fixture = calloc(1, sizeof *fixture);
  char path[96];
  strcpy(fixture->root, "/tmp/lodestream-jail-XXXXXX");
  assert_non_null(mkdtemp(fixture->root));
  snprintf(path, sizeof path, "%s/output", fixture->root);
  assert_int_equal(mkdir(path, 0700), 0);
  fixture->output_fd = open(path, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  snprintf(path, sizeof path, "%s/secret", fixture->root);
  fixture->secret_fd = open(path, O_RDWR | O_CREAT, 0600);
  assert_int_equal(write(fixture->secret_fd, "secret", 6), 6);
  assert_int_equal(socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, fixture->sockets), 0);
  fixture->victim = fork();
  if (fixture->victim == 0)
    for (;;)
      pause();
  fixture->server_fd = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
  fixture->server = (struct sockaddr_in){.sin_family = AF_INET, .sin_addr = {htonl(INADDR_LOOPBACK)}};
  socklen_t size = sizeof fixture->server;
  assert_int_equal(bind(fixture->server_fd, (struct sockaddr *)&fixture->server, size), 0);
  assert_int_equal(listen(fixture->server_fd, 4), 0);
  assert_int_equal(getsockname(fixture->server_fd, (struct sockaddr *)&fixture->server, &size), 0);
  *state = fixture;
  return 0;
}

static int tear_down(void **state) {
  struct fixture *fixture = *state;
  int status;
  assert_int_equal(waitpid(fixture->victim, &status, WNOHANG), 0); /* no attempt has hurt it */
  kill(fixture->victim, SIGKILL);
  waitpid(fixture->victim, &status, 0);
  close(fixture->server_fd);
  close(fixture->sockets[0]);
  close(fixture->sockets[1]);
  close(fixture->output_fd);
  close(fixture->secret_fd);
  lod_remove_tree(AT_FDCWD, fixture->root);
  free(fixture);
  return 0;
}

enum { STOPPED = 0, SUCCEEDED = 1, NO_JAIL = 2, WENT_WRONG = 3 };

/* System calls that a poorer kernel or a strict container would refuse. */
struct handicap {
  const char *what;
  int error;
  int calls[4]; /* 0 = no more */
};
static const struct handicap kFree = {"nothing is missing", 0, {0}};
static const struct handicap kNoNamespaces = {"no namespaces, no root of its own", EPERM, {SCMP_SYS(unshare), SCMP_SYS(chroot)}};
static const struct handicap kNoLandlock = {"no Landlock", ENOSYS, {444, 445, 446}};
static const struct handicap kNoFiles = {"neither", EPERM, {SCMP_SYS(unshare), SCMP_SYS(chroot), 444}};
static const struct handicap kNoCapset = {"no capset", EPERM, {SCMP_SYS(capset)}};
static const struct handicap kNoSeccomp = {"no seccomp", EINVAL, {SCMP_SYS(seccomp)}};

static void suffer(const struct handicap *handicap) {
  scmp_filter_ctx filter = seccomp_init(SCMP_ACT_ALLOW);
  for (int i = 0; i < 4 && handicap->calls[i] != 0; i++)
    if (seccomp_rule_add(filter, SCMP_ACT_ERRNO((uint32_t)handicap->error), handicap->calls[i], 0) != 0)
      _exit(WENT_WRONG);
  if (seccomp_load(filter) != 0)
    _exit(WENT_WRONG);
  seccomp_release(filter);
}

/* In the child: descriptors as a worker has them, then the jail. */
static void enter(struct fixture *fixture, struct lod_jail_report *report) {
  struct lod_problem problem = {0};
  struct lod_jail_settings settings = lod_jail_defaults();
  settings.strategy = "auto";
  settings.max_memory_bytes = 256 << 20;
  settings.max_cpu_seconds = 2;
  settings.max_file_bytes = 1 << 20;
  int input_fd = open("/proc/self/exe", O_RDONLY);
  const int wanted[] = {fcntl(fixture->sockets[0], F_DUPFD, 20), fcntl(input_fd, F_DUPFD, 20), fcntl(fixture->output_fd, F_DUPFD, 20)};
  for (int i = 0; i < 3; i++)
    dup2(wanted[i], 3 + i);
  if (lod_jail_enter(&settings, report, &problem) != LOD_OK) {
    fprintf(stderr, "%s: %s\n", problem.type, problem.detail);
    _exit(NO_JAIL);
  }
}

/* ---- what must go on ---- */

static void add_up(void *context, size_t begin, size_t end, size_t chunk) {
  (void)chunk;
  for (size_t i = begin; i < end; i++)
    ((double *)context)[i] = (double)i * 0.5;
}

static void *allocate(void *argument) {
  for (size_t size = 1; size < 1 << 24; size = size * 3 + 1) {
    char *block = malloc(size);
    if (block == NULL)
      return argument;
    memset(block, 1, size);
    free(block);
  }
  return NULL;
}

#define MUST(condition)                                                                                                                    \
  do {                                                                                                                                     \
    if (!(condition)) {                                                                                                                    \
      fprintf(stderr, "line %d: %s (%s)\n", __LINE__, #condition, strerror(errno));                                                        \
      _exit(WENT_WRONG);                                                                                                                   \
    }                                                                                                                                      \
  } while (0)

static void work_as_a_bake_does(void) {
  static double values[100000];
  pthread_t thread;
  void *result = values;
  lod_parallel_for(4, 100000, 1000, add_up, values);
  MUST(values[99999] == 49999.5);
  MUST(pthread_create(&thread, NULL, allocate, values) == 0 && pthread_join(thread, &result) == 0 && result == NULL);
  MUST(allocate(values) == NULL);
  struct stat facts;
  MUST(fstat(LOD_WORKER_INPUT_FD, &facts) == 0 && facts.st_size > 0);
  const char *input = mmap(NULL, (size_t)facts.st_size, PROT_READ, MAP_PRIVATE, LOD_WORKER_INPUT_FD, 0);
  MUST(input != MAP_FAILED && memcmp(input,
                                     "\x7f"
                                     "ELF",
                                     4) == 0);
  MUST(mkdirat(LOD_WORKER_OUTPUT_FD, "objects", 0700) == 0);
  int fd = openat(LOD_WORKER_OUTPUT_FD, "objects/new", O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0600);
  MUST(fd >= 0 && write(fd, "bytes", 5) == 5 && fsync(fd) == 0 && close(fd) == 0);
  MUST(renameat(LOD_WORKER_OUTPUT_FD, "objects/new", LOD_WORKER_OUTPUT_FD, "object") == 0);
  int folder = openat(LOD_WORKER_OUTPUT_FD, ".", O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  MUST(folder >= 0 && fsync(folder) == 0 && close(folder) == 0);
  fd = openat(LOD_WORKER_OUTPUT_FD, "object", O_RDONLY | O_CLOEXEC);
  char bytes[5];
  MUST(fd >= 0 && read(fd, bytes, 5) == 5 && close(fd) == 0 && unlinkat(LOD_WORKER_OUTPUT_FD, "object", 0) == 0);
  MUST(unlinkat(LOD_WORKER_OUTPUT_FD, "objects", AT_REMOVEDIR) == 0);
  MUST(lod_frame_write(LOD_WORKER_SOCKET_FD, 'P', "{\"stage\":\"x\",\"progress\":0}", 26) == LOD_OK);
  struct timespec time = {.tv_nsec = 1000};
  MUST(nanosleep(&time, NULL) == 0 && clock_gettime(CLOCK_MONOTONIC, &time) == 0 && clock_gettime(CLOCK_THREAD_CPUTIME_ID, &time) == 0);
  MUST(fprintf(stderr, "%s", "") == 0 && sysconf(_SC_NPROCESSORS_ONLN) >= 1);
}

static void what_a_bake_needs_goes_on(void **state) {
  struct fixture *fixture = *state;
  pid_t child = fork();
  if (child == 0) {
    enter(fixture, NULL);
    work_as_a_bake_does();
    _exit(0);
  }
  int status;
  assert_int_equal(waitpid(child, &status, 0), child);
  assert_true(WIFEXITED(status));
  assert_int_equal(WEXITSTATUS(status), 0);
}

static void an_ordinary_user_needs_no_privileges_for_it(void **state) {
  struct fixture *fixture = *state;
  if (geteuid() != 0)
    skip(); /* then all the others show it */
  assert_int_equal(fchown(fixture->output_fd, 65534, 65534), 0);
  pid_t child = fork();
  if (child == 0) {
    MUST(setgid(65534) == 0 && setuid(65534) == 0);
    enter(fixture, NULL);
    work_as_a_bake_does();
    _exit(0);
  }
  int status;
  assert_int_equal(waitpid(child, &status, 0), child);
  assert_true(WIFEXITED(status));
  assert_int_equal(WEXITSTATUS(status), 0);
}

static void abort_still_ends_by_its_own_signal(void **state) {
  struct fixture *fixture = *state;
  pid_t child = fork();
  if (child == 0) {
    enter(fixture, NULL);
    signal(SIGABRT, SIG_DFL);
    abort();
  }
  int status;
  assert_int_equal(waitpid(child, &status, 0), child);
  assert_true(WIFSIGNALED(status));
  assert_int_equal(WTERMSIG(status), SIGABRT);
}

/* ---- what must be stopped ---- */

static struct fixture *here; /* of the attempt */

static bool try_open(const char *path, int flags) {
  int fd = open(path, flags | O_CLOEXEC, 0600);
  if (fd >= 0)
    close(fd);
  return fd >= 0;
}
static bool read_passwords(void) {
  return try_open("/etc/passwd", O_RDONLY);
}
static bool read_own_process(void) {
  return try_open("/proc/self/environ", O_RDONLY) || try_open("/proc/self/mem", O_RDWR);
}
static bool read_device(void) {
  return try_open("/dev/mem", O_RDONLY) || try_open("/dev/kmsg", O_RDONLY) || try_open("/dev/vda", O_RDONLY);
}
static bool read_neighbour(void) {
  char path[96];
  snprintf(path, sizeof path, "%s/secret", here->root);
  return try_open(path, O_RDONLY) || try_open("../secret", O_RDONLY) || openat(LOD_WORKER_OUTPUT_FD, "../secret", O_RDONLY) >= 0;
}
/* Whether these two succeed is seen from outside: beneath a root of its own ".." is the output folder again. */
static bool write_outside(void) {
  char path[96];
  snprintf(path, sizeof path, "%s/new", here->root);
  (void)try_open(path, O_WRONLY | O_CREAT);
  (void)openat(LOD_WORKER_OUTPUT_FD, "../new", O_WRONLY | O_CREAT | O_EXCL, 0600);
  return false;
}
static bool list_root(void) {
  struct stat root, output;
  int fd = open("/", O_RDONLY | O_DIRECTORY);
  return fd >= 0 && fstat(fd, &root) == 0 && fstat(LOD_WORKER_OUTPUT_FD, &output) == 0 && root.st_ino != output.st_ino;
}
static bool follow_link_out(void) {
  return symlinkat("/etc/passwd", LOD_WORKER_OUTPUT_FD, "link") == 0 ||
         linkat(AT_FDCWD, "/etc/passwd", LOD_WORKER_OUTPUT_FD, "link", 0) == 0;
}
static bool move_out(void) {
  (void)openat(LOD_WORKER_OUTPUT_FD, "mine", O_WRONLY | O_CREAT, 0600);
  (void)renameat(LOD_WORKER_OUTPUT_FD, "mine", LOD_WORKER_OUTPUT_FD, "../mine");
  return false;
}
static bool make_device(void) {
  return mknodat(LOD_WORKER_OUTPUT_FD, "device", S_IFCHR | 0600, 1 << 8 | 3) == 0;
}
static bool use_forgotten_descriptor(void) {
  return pwrite(here->secret_fd, "X", 1, 0) == 1;
}
static bool run_program(void) {
  char *const arguments[] = {(char *)"/bin/true", NULL};
  execve("/bin/true", arguments, NULL);
  return errno != EPERM && errno != EACCES && errno != ENOENT;
}
static bool run_from_descriptor(void) {
  char *const arguments[] = {(char *)"x", NULL};
  syscall(SYS_execveat, LOD_WORKER_INPUT_FD, "", arguments, NULL, AT_EMPTY_PATH);
  return errno != EPERM && errno != EACCES;
}
static bool start_process(void) {
  pid_t child = fork();
  if (child == 0)
    _exit(0);
  return child > 0;
}
static bool start_process_by_clone3(void) {
  struct {
    uint64_t flags, pidfd, child_tid, parent_tid, exit_signal, stack, stack_size, tls;
  } arguments = {.exit_signal = SIGCHLD};
  long child = syscall(435, &arguments, sizeof arguments);
  if (child == 0)
    _exit(0);
  return child > 0;
}
static bool connect_over_network(void) {
  int fd = socket(AF_INET, SOCK_STREAM, 0);
  return fd >= 0 && connect(fd, (struct sockaddr *)&here->server, sizeof here->server) == 0;
}
static bool connect_on_given_socket(void) {
  return connect(LOD_WORKER_SOCKET_FD, (struct sockaddr *)&here->server, sizeof here->server) == 0;
}
static bool send_to_address(void) {
  return sendto(LOD_WORKER_SOCKET_FD, "x", 1, 0, (struct sockaddr *)&here->server, sizeof here->server) == 1;
}
static bool send_descriptor(void) {
  struct msghdr message = {0};
  struct iovec vector = {(void *)"x", 1};
  message.msg_iov = &vector;
  message.msg_iovlen = 1;
  return sendmsg(LOD_WORKER_SOCKET_FD, &message, 0) >= 0;
}
static bool make_socket_pair(void) {
  int fds[2];
  return socketpair(AF_UNIX, SOCK_STREAM, 0, fds) == 0 || socket(AF_UNIX, SOCK_DGRAM, 0) >= 0 || socket(AF_NETLINK, SOCK_RAW, 0) >= 0;
}
static bool kill_neighbour(void) {
  return kill(here->victim, SIGKILL) == 0;
}
static bool kill_parent(void) {
  return kill(getppid(), 0) == 0;
}
static bool kill_everyone(void) {
  return kill(-1, SIGTERM) == 0;
}
static bool kill_thread_of_neighbour(void) {
  return syscall(SYS_tgkill, here->victim, here->victim, SIGKILL) == 0;
}
static bool signal_by_descriptor(void) {
  return fcntl(LOD_WORKER_SOCKET_FD, F_SETOWN, here->victim) == 0 || fcntl(LOD_WORKER_SOCKET_FD, 10 /* F_SETSIG */, SIGKILL) == 0;
}
static bool trace_neighbour(void) {
  return ptrace(PTRACE_ATTACH, here->victim, NULL, NULL) == 0;
}
static bool read_memory_of_neighbour(void) {
  char byte;
  struct iovec to = {&byte, 1}, from = {here, 1};
  return process_vm_readv(here->victim, &to, 1, &from, 1, 0) == 1;
}
static bool make_executable_page(void) {
  return mmap(NULL, 4096, PROT_READ | PROT_WRITE | PROT_EXEC, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0) != MAP_FAILED;
}
static bool make_page_executable(void) {
  void *page = mmap(NULL, 4096, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
  return page == MAP_FAILED || mprotect(page, 4096, PROT_READ | PROT_EXEC) == 0;
}
static bool make_namespace(void) {
  return unshare(CLONE_NEWUSER) == 0;
}
static bool escape_root(void) {
  return chroot("/proc/1/root") == 0 || chroot("..") == 0;
}
static bool set_user(void) {
  return setuid(0) == 0 && geteuid() == 0;
}
static bool raise_limit(void) {
  struct rlimit limit = {1024, 1024};
  return setrlimit(RLIMIT_NOFILE, &limit) == 0;
}
static bool load_rules(void) {
  return syscall(SYS_bpf, 0, NULL, 0) >= 0;
}
static bool make_ring(void) {
  char parameters[120] = {0};
  return syscall(425 /* io_uring_setup */, 8, parameters) >= 0;
}
static bool make_memory_file(void) {
  return syscall(SYS_memfd_create, "x", 0u) >= 0;
}
static bool leave_jail(void) {
  return prctl(PR_SET_DUMPABLE, 1, 0, 0, 0) == 0 || prctl(PR_SET_SECCOMP, 0, 0, 0, 0) == 0;
}
static bool write_large_file(void) {
  static char block[1 << 16];
  signal(SIGXFSZ, SIG_IGN);
  int fd = openat(LOD_WORKER_OUTPUT_FD, "large", O_WRONLY | O_CREAT, 0600);
  for (int i = 0; i < 17; i++)
    if (write(fd, block, sizeof block) != sizeof block)
      return false;
  return true;
}
static bool open_many(void) {
  for (int i = 0; i < 1000; i++)
    if (openat(LOD_WORKER_OUTPUT_FD, "many", O_WRONLY | O_CREAT, 0600) < 0)
      return false;
  return true;
}
static bool eat_memory(void) {
  for (size_t i = 0; i < 1024; i++) {
    char *block = malloc(1 << 20);
    if (block == NULL)
      return false;
    memset(block, 1, 1 << 20);
  }
  return true;
}
static bool spin(void) {
  struct timespec start, time;
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &start);
  do
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &time);
  while (time.tv_sec - start.tv_sec < 6);
  return true;
}

struct attempt {
  const char *what;
  bool (*act)(void);
  bool not_sanitized;     /* AddressSanitizer is in the way */
  bool needs_confinement; /* Landlock or a root of its own stops it, nothing else does */
};
static const struct attempt kAttempts[] = {
    {"read /etc/passwd", read_passwords, false, true},
    {"read its own /proc", read_own_process, false, true},
    {"read devices", read_device, false, true},
    {"read a file beside the output folder", read_neighbour, false, true},
    {"write beside the output folder", write_outside, false, true},
    {"list the old root", list_root, false, true},
    {"link to a file outside", follow_link_out, false, false},
    {"move a file out", move_out, false, true},
    {"make a device", make_device, false, false},
    {"use a descriptor that was left open", use_forgotten_descriptor, false, false},
    {"run a program", run_program, false, false},
    {"run its input", run_from_descriptor, false, false},
    {"start a process", start_process, false, false},
    {"start a process by clone3", start_process_by_clone3, false, false},
    {"connect over the network", connect_over_network, false, false},
    {"connect its own socket elsewhere", connect_on_given_socket, false, false},
    {"send to an address", send_to_address, false, false},
    {"send a message with control data", send_descriptor, false, false},
    {"make sockets", make_socket_pair, false, false},
    {"kill a process of the same user", kill_neighbour, false, false},
    {"signal its parent", kill_parent, false, false},
    {"signal everyone", kill_everyone, false, false},
    {"signal a thread of another process", kill_thread_of_neighbour, false, false},
    {"have the kernel signal another process", signal_by_descriptor, false, false},
    {"trace a process of the same user", trace_neighbour, false, false},
    {"read another process's memory", read_memory_of_neighbour, false, false},
    {"map an executable page", make_executable_page, false, false},
    {"make a page executable", make_page_executable, false, false},
    {"make a namespace", make_namespace, false, false},
    {"change its root", escape_root, false, false},
    {"become another user", set_user, false, false},
    {"raise a limit", raise_limit, false, false},
    {"load BPF", load_rules, false, false},
    {"make an io_uring", make_ring, false, false},
    {"make a file in memory", make_memory_file, false, false},
    {"undo the jail", leave_jail, false, false},
    {"write a file over the limit", write_large_file, false, false},
    {"open a thousand files", open_many, false, false},
    {"eat memory", eat_memory, true, false},
    {"spin for ever", spin, false, false},
};

/* What stopped it, in words. */
static void describe(int status, int error, char *text, size_t size) {
  if (WIFSIGNALED(status))
    snprintf(text, size, "SIG%s", sigabbrev_np(WTERMSIG(status)));
  else if (error == 0)
    snprintf(text, size, "stays inside");
  else
    snprintf(text, size, "%s", strerrorname_np(error) == NULL ? "refused" : strerrorname_np(error));
}

/* Nothing but the output folder and the secret is beside the output folder. */
static bool outside_is_untouched(const struct fixture *fixture) {
  int fd = open(fixture->root, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  struct lod_name_list names = lod_list_folder(fd);
  size_t count = names.count;
  lod_name_list_finish(&names);
  close(fd);
  return count == 2;
}

/* True when it was stopped. */
static bool attempt(struct fixture *fixture, const struct attempt *what, const struct handicap *handicap, char *how, size_t size) {
  int *error = mmap(NULL, 4096, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
  assert_true(error != MAP_FAILED);
  pid_t child = fork();
  if (child == 0) {
    here = fixture;
    if (handicap != &kFree)
      suffer(handicap);
    enter(fixture, NULL);
    errno = 0;
    bool succeeded = what->act();
    *error = errno;
    _exit(succeeded ? SUCCEEDED : STOPPED);
  }
  int status;
  assert_int_equal(waitpid(child, &status, 0), child);
  describe(status, *error, how, size);
  munmap(error, 4096);
  if (!outside_is_untouched(fixture))
    return false;
  if (WIFEXITED(status))
    return WEXITSTATUS(status) == STOPPED;
  int number = WTERMSIG(status);
  return number == SIGSYS || number == SIGXCPU || number == SIGKILL || (number == SIGABRT && what->not_sanitized);
}

static void every_escape_is_stopped(void **state) {
  struct fixture *fixture = *state;
  bool all = true;
  for (size_t i = 0; i < sizeof kAttempts / sizeof kAttempts[0]; i++) {
    char how[48];
    if (SANITIZED && kAttempts[i].not_sanitized)
      continue;
    bool stopped = attempt(fixture, &kAttempts[i], &kFree, how, sizeof how);
    print_message("  %-42s %s %s\n", kAttempts[i].what, stopped ? "stopped:" : "NOT STOPPED:", how);
    all &= stopped;
  }
  assert_true(all);
  char secret[6];
  assert_int_equal(pread(fixture->secret_fd, secret, 6, 0), 6);
  assert_memory_equal(secret, "secret", 6);
}

/* Each layer holds alone what it is there for. */
static void escapes_are_stopped_under(struct fixture *fixture, const struct handicap *handicap, bool files) {
  for (size_t i = 0; i < sizeof kAttempts / sizeof kAttempts[0]; i++) {
    char how[48];
    if (kAttempts[i].act == spin || kAttempts[i].act == eat_memory || (!files && kAttempts[i].needs_confinement))
      continue;
    if (!attempt(fixture, &kAttempts[i], handicap, how, sizeof how))
      fail_msg("%s: %s is not stopped: %s", handicap->what, kAttempts[i].what, how);
  }
}

static void landlock_alone_keeps_files_safe(void **state) {
  escapes_are_stopped_under(*state, &kNoNamespaces, true);
}
static void a_root_of_its_own_alone_keeps_files_safe(void **state) {
  escapes_are_stopped_under(*state, &kNoLandlock, true);
}
static void without_either_all_but_files_is_safe(void **state) {
  escapes_are_stopped_under(*state, &kNoFiles, false);
}

static void a_required_step_that_fails_refuses_the_job(void **state) {
  struct fixture *fixture = *state;
  const struct handicap *const kHandicaps[] = {&kNoCapset, &kNoSeccomp};
  for (size_t i = 0; i < 2; i++) {
    pid_t child = fork();
    if (child == 0) {
      suffer(kHandicaps[i]);
      enter(fixture, NULL);
      _exit(0);
    }
    int status;
    assert_int_equal(waitpid(child, &status, 0), child);
    assert_true(WIFEXITED(status));
    assert_int_equal(WEXITSTATUS(status), NO_JAIL);
  }
}

/* Without the jail most of these succeed: the attempts can fail to be stopped. */
static void the_attempts_do_succeed_outside_of_the_jail(void **state) {
  struct fixture *fixture = *state;
  bool (*const free_acts[])(void) = {read_passwords,       read_neighbour,       start_process,    connect_over_network, make_socket_pair,
                                     make_executable_page, make_page_executable, make_memory_file, kill_parent};
  for (size_t i = 0; i < sizeof free_acts / sizeof free_acts[0]; i++) {
    pid_t child = fork();
    if (child == 0) {
      here = fixture;
      dup2(fixture->output_fd, LOD_WORKER_OUTPUT_FD);
      _exit(free_acts[i]() ? SUCCEEDED : STOPPED);
    }
    int status;
    assert_int_equal(waitpid(child, &status, 0), child);
    if (!WIFEXITED(status) || WEXITSTATUS(status) != SUCCEEDED)
      fail_msg("attempt %zu does not succeed even without a jail", i);
  }
}

/* ---- the report ---- */

static void the_report_says_what_is_active(void **state) {
  struct fixture *fixture = *state;
  struct lod_jail_report *report = mmap(NULL, sizeof *report, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
  assert_true(report != MAP_FAILED);
  pid_t child = fork();
  if (child == 0) {
    enter(fixture, report);
    _exit(0);
  }
  int status;
  assert_int_equal(waitpid(child, &status, 0), child);
  assert_true(WIFEXITED(status) && WEXITSTATUS(status) == 0);
  for (size_t i = 0; i < LOD_JAIL_STEPS; i++) {
    const struct lod_jail_step *step = &report->steps[i];
    print_message("  %-18s %s: %s\n", step->name, step->state == LOD_JAIL_ACTIVE ? "active" : "unavailable", step->detail);
    assert_true(step->state == LOD_JAIL_ACTIVE || (step->state == LOD_JAIL_UNAVAILABLE && !step->required));
    assert_true(step->detail[0] != 0);
  }
  char json[4096], cut[32];
  size_t length = lod_jail_report_json(report, json, sizeof json);
  assert_int_equal(length, strlen(json));
  assert_non_null(strstr(json, "\"seccomp\":{\"state\":\"active\",\"required\":true"));
  assert_int_equal(lod_jail_report_json(report, cut, sizeof cut), sizeof cut - 1);
  munmap(report, sizeof *report);
}

static void a_wrong_strategy_is_refused_and_none_is_reported_as_off(void **state) {
  (void)state;
  struct lod_jail_report report;
  struct lod_problem problem = {0};
  struct lod_jail_settings settings = lod_jail_defaults();
  settings.strategy = "nome";
  assert_int_equal(lod_jail_enter(&settings, &report, &problem), LOD_BAD_INPUT);
  assert_string_equal(problem.type, "jail-strategy");
  settings.strategy = NULL;
  setenv("LODESTREAM_JAIL", "none", 1);
  assert_int_equal(lod_jail_enter(&settings, &report, NULL), LOD_OK);
  unsetenv("LODESTREAM_JAIL");
  for (size_t i = 0; i < LOD_JAIL_STEPS; i++)
    assert_int_equal(report.steps[i].state, LOD_JAIL_OFF);
}

static void without_an_output_folder_there_is_no_jail_and_no_bake(void **state) {
  (void)state;
  pid_t child = fork();
  if (child == 0) {
    struct lod_problem problem = {0};
    struct lod_jail_settings settings = lod_jail_defaults();
    settings.strategy = "auto";
    close(LOD_WORKER_OUTPUT_FD);
    _exit(lod_jail_enter(&settings, NULL, &problem) == LOD_UNSUPPORTED && strcmp(problem.type, "jail-descriptors") == 0 ? 0 : 1);
  }
  int status;
  assert_int_equal(waitpid(child, &status, 0), child);
  assert_true(WIFEXITED(status) && WEXITSTATUS(status) == 0);
}

int main(void) {
  const struct CMUnitTest tests[] = {
#define TEST(name) cmocka_unit_test_setup_teardown(name, set_up, tear_down)
      TEST(the_report_says_what_is_active),
      TEST(what_a_bake_needs_goes_on),
      TEST(an_ordinary_user_needs_no_privileges_for_it),
      TEST(abort_still_ends_by_its_own_signal),
      TEST(every_escape_is_stopped),
      TEST(landlock_alone_keeps_files_safe),
      TEST(a_root_of_its_own_alone_keeps_files_safe),
      TEST(without_either_all_but_files_is_safe),
      TEST(a_required_step_that_fails_refuses_the_job),
      TEST(the_attempts_do_succeed_outside_of_the_jail),
      TEST(a_wrong_strategy_is_refused_and_none_is_reported_as_off),
      TEST(without_an_output_folder_there_is_no_jail_and_no_bake),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
