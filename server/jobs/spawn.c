#include "server/jobs/spawn.h"

#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include "server/jobs/frame.h"

#if defined(__SANITIZE_ADDRESS__)
#define SANITIZED 1
#elif defined(__has_feature)
#if __has_feature(address_sanitizer) || __has_feature(thread_sanitizer)
#define SANITIZED 1
#endif
#endif
#ifndef SANITIZED
#define SANITIZED 0
#endif

enum { MAX_FILES = 64, FIRST_SPARE_FD = 10, MAX_ENVIRONMENT = 8 };

/* Libraries, mapped input and thread stacks beside the memory that counts. */
static const uint64_t kAddressRoom = UINT64_C(8) << 30;

struct limit {
  int resource;
  uint64_t value;
};

struct child {
  const struct lod_spawn_settings *settings;
  int socket_fd, log_fd, null_fd, error_fd;
  pid_t parent;
  struct limit limits[8];
  size_t limit_count;
  char *environment[MAX_ENVIRONMENT];
};

/* ---- prepared before the fork: memory may be allocated ---- */

static void prepare_limits(struct child *child) {
  const struct lod_spawn_settings *settings = child->settings;
  /* No RLIMIT_NPROC: it counts all processes of the user, so a busy user would keep a worker from having threads. The jail forbids
   * new processes instead. */
  const struct limit limits[] = {{RLIMIT_CORE, 0},
                                 {RLIMIT_NOFILE, MAX_FILES},
                                 {RLIMIT_CPU, settings->cpu_limit_seconds},
                                 {RLIMIT_FSIZE, settings->memory_limit_bytes},
                                 {RLIMIT_MEMLOCK, 0},
                                 {RLIMIT_MSGQUEUE, 0},
                                 {RLIMIT_DATA, settings->memory_limit_bytes},
                                 {RLIMIT_AS, settings->memory_limit_bytes + kAddressRoom}};
  /* Sanitizers reserve terabytes of shadow, which the last two would forbid. */
  child->limit_count = sizeof limits / sizeof limits[0] - (SANITIZED ? 2 : 0);
  memcpy(child->limits, limits, sizeof limits);
}

/* Names that pass from our environment to the worker's. */
static const char *const kPassed[] = {"LODESTREAM_JAIL", "UBSAN_OPTIONS", "ASAN_OPTIONS"};

static bool prepare_environment(struct child *child) {
  size_t count = 0;
  bool complete = true;
  child->environment[count++] = strdup("PATH=/usr/bin:/bin");
  child->environment[count++] = strdup("LC_ALL=C");
  for (size_t i = 0; i < sizeof kPassed / sizeof kPassed[0]; i++) {
    const char *value = getenv(kPassed[i]);
    bool asan = SANITIZED && strcmp(kPassed[i], "ASAN_OPTIONS") == 0;
    /* The leak check at exit traces the process, which a jail forbids. */
    if (asan)
      complete &= asprintf(&child->environment[count++], "%s=%s:detect_leaks=0", kPassed[i], value == NULL ? "" : value) >= 0;
    else if (value != NULL)
      complete &= asprintf(&child->environment[count++], "%s=%s", kPassed[i], value) >= 0;
  }
  child->environment[count] = NULL;
  return complete && child->environment[0] != NULL && child->environment[1] != NULL;
}

/* ---- in the child: async-signal-safe calls alone, since other threads of the daemon held locks when it forked ---- */

_Noreturn static void give_up(const struct child *child) {
  int code = errno;
  ssize_t ignored = write(child->error_fd, &code, sizeof code);
  (void)ignored;
  _exit(127);
}

static void place_descriptors(const struct child *child) {
  const int wanted[] = {
      child->null_fd, child->log_fd, child->log_fd, child->socket_fd, child->settings->input_fd, child->settings->output_fd};
  int spare[6];
  for (int i = 0; i < 6; i++) /* out of the way first: any of them may sit where another has to go */
    if ((spare[i] = fcntl(wanted[i], F_DUPFD_CLOEXEC, FIRST_SPARE_FD)) < 0)
      give_up(child);
  for (int i = 0; i < 6; i++)
    if (dup2(spare[i], i) < 0)
      give_up(child);
      /* All others are close-on-exec by our own rule; this catches a library that forgot. */
#ifdef SYS_close_range
  if (syscall(SYS_close_range, 6u, ~0u, 4u /* CLOSE_RANGE_CLOEXEC */) == 0)
    return;
#endif
  for (int fd = 6; fd < 65536; fd++)
    if (fcntl(fd, F_SETFD, FD_CLOEXEC) != 0 && fd > 4096)
      break;
}

static void reset_signals(void) {
  struct sigaction action = {.sa_handler = SIG_DFL};
  for (int number = 1; number < NSIG; number++)
    sigaction(number, &action, NULL);
  sigset_t none;
  sigemptyset(&none);
  sigprocmask(SIG_SETMASK, &none, NULL);
}

static void prefer_as_victim(void) {
  int fd = open("/proc/self/oom_score_adj", O_WRONLY | O_CLOEXEC);
  if (fd < 0)
    return;
  ssize_t ignored = write(fd, "800", 3); /* when memory runs out the kernel shall end a bake, not the daemon */
  (void)ignored;
  close(fd);
}

_Noreturn static void run_child(const struct child *child) {
  reset_signals();
  if (setpgid(0, 0) != 0 || prctl(PR_SET_PDEATHSIG, SIGKILL) != 0)
    give_up(child);
  if (getppid() != child->parent) /* it died before the line above */
    _exit(127);
  prefer_as_victim();
  if (child->settings->niceness != LOD_NICE_ANSWER)
    setpriority(PRIO_PROCESS, 0, child->settings->niceness);
  place_descriptors(child);
  for (size_t i = 0; i < child->limit_count; i++) {
    struct rlimit limit;
    if (getrlimit(child->limits[i].resource, &limit) != 0)
      give_up(child);
    rlim_t value = child->limits[i].value < limit.rlim_max ? child->limits[i].value : limit.rlim_max;
    limit = (struct rlimit){value, value};
    /* At the soft limit comes SIGXCPU, which tells what happened; at the hard one plain SIGKILL. */
    if (child->limits[i].resource == RLIMIT_CPU && value > 1)
      limit.rlim_cur = value - 1;
    if (setrlimit(child->limits[i].resource, &limit) != 0)
      give_up(child);
  }
  char *const arguments[] = {(char *)child->settings->path, (char *)"worker", NULL};
  execve(child->settings->path, arguments, child->environment);
  give_up(child);
}

/* ---- in the parent ---- */

static void close_if_open(int fd) {
  if (fd >= 0)
    close(fd);
}

/* 0 when the program has started, else errno of what failed. The end of the pipe is close-on-exec. */
static int read_error(int fd) {
  int code = 0;
  ssize_t got;
  do
    got = read(fd, &code, sizeof code);
  while (got < 0 && errno == EINTR);
  return got == sizeof code ? code : 0;
}

static enum lod_status start(struct child *child, int error_fd, struct lod_process *process, struct lod_problem *problem) {
  child->parent = getpid();
  pid_t pid = fork();
  if (pid < 0)
    return lod_fail(problem, LOD_IO, "worker-missing", "A worker process cannot be started: %s.", strerror(errno));
  if (pid == 0)
    run_child(child);
  close(child->error_fd);
  child->error_fd = -1;
  int code = read_error(error_fd);
  if (code != 0) {
    waitpid(pid, NULL, 0);
    return lod_fail(problem, LOD_IO, "worker-missing", "The worker program %.200s cannot be started: %s.", child->settings->path,
                    strerror(code));
  }
  process->pid = pid;
#ifdef SYS_pidfd_open
  process->pid_fd = (int)syscall(SYS_pidfd_open, pid, 0u);
#endif
  return LOD_OK;
}

enum lod_status lod_process_spawn(const struct lod_spawn_settings *settings, struct lod_process *process, struct lod_problem *problem) {
  *process = (struct lod_process){.pid_fd = -1, .socket_fd = -1, .log_fd = -1};
  struct child child = {.settings = settings, .error_fd = -1};
  int sockets[2] = {-1, -1}, log[2] = {-1, -1}, error[2] = {-1, -1};
  prepare_limits(&child);
  enum lod_status status = prepare_environment(&child) ? LOD_OK : lod_fail_memory(problem);
  child.null_fd = open("/dev/null", O_RDWR | O_CLOEXEC);
  if (status == LOD_OK && (child.null_fd < 0 || socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, sockets) != 0 ||
                           pipe2(log, O_CLOEXEC) != 0 || pipe2(error, O_CLOEXEC) != 0 || fcntl(log[0], F_SETFL, O_NONBLOCK) != 0))
    status = lod_fail(problem, LOD_IO, "worker-missing", "A worker process cannot be prepared: %s.", strerror(errno));
  child.socket_fd = sockets[1];
  child.log_fd = log[1];
  child.error_fd = error[1];
  if (status == LOD_OK)
    status = start(&child, error[0], process, problem);
  if (status == LOD_OK) {
    process->socket_fd = sockets[0];
    process->log_fd = log[0];
  } else {
    close_if_open(sockets[0]);
    close_if_open(log[0]);
  }
  const int ours[] = {child.null_fd, sockets[1], log[1], error[0], child.error_fd};
  for (size_t i = 0; i < sizeof ours / sizeof ours[0]; i++)
    close_if_open(ours[i]);
  for (size_t i = 0; i < MAX_ENVIRONMENT; i++)
    free(child.environment[i]);
  return status;
}

bool lod_process_has_ended(const struct lod_process *process) {
  siginfo_t info = {0};
  return waitid(P_PID, (id_t)process->pid, &info, WEXITED | WNOHANG | WNOWAIT) == 0 && info.si_pid == process->pid;
}

struct lod_process_end lod_process_finish(struct lod_process *process) {
  /* A group keeps its number until its leader is reaped, so this cannot hit a stranger. */
  kill(-process->pid, SIGKILL);
  int state = 0;
  while (waitpid(process->pid, &state, 0) < 0 && errno == EINTR)
    ;
  close_if_open(process->pid_fd);
  close_if_open(process->socket_fd);
  close_if_open(process->log_fd);
  *process = (struct lod_process){.pid_fd = -1, .socket_fd = -1, .log_fd = -1};
  return WIFSIGNALED(state) ? (struct lod_process_end){WTERMSIG(state), 0} : (struct lod_process_end){0, WEXITSTATUS(state)};
}
