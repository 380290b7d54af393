/* What each step is for, and why in this order: namespaces and the new root need capabilities that the next step drops; Landlock and
 * seccomp need no_new_privs; seccomp comes last because it forbids all of the above. */
#include "server/worker/jail.h"

#include <errno.h>
#include <fcntl.h>
#include <linux/capability.h>
#include <sched.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <unistd.h>

#include "server/jobs/frame.h"
#include "server/worker/jail_filter.h"

#if defined(__SANITIZE_ADDRESS__)
#define SANITIZED 1
#elif defined(__has_feature)
#if __has_feature(address_sanitizer)
#define SANITIZED 1
#endif
#endif
#ifndef SANITIZED
#define SANITIZED 0
#endif

enum { MAX_FILES = 64, MAX_PROCESSES = 512 };

struct jail {
  const struct lod_jail_settings *settings;
  struct lod_jail_report *report;
  bool own_users;      /* in a user namespace of its own */
  struct stat root;    /* of the file system before */
  struct stat network; /* the network namespace before; st_ino 0 = not known */
};

/* A step returns true when it is done and read back; else it says why in `detail`. */
typedef bool step_function(struct jail *jail, struct lod_jail_step *step);

__attribute__((format(printf, 2, 3))) static bool because(struct lod_jail_step *step, const char *format, ...) {
  va_list arguments;
  va_start(arguments, format);
  vsnprintf(step->detail, sizeof step->detail, format, arguments);
  va_end(arguments);
  return false;
}

static bool done(struct lod_jail_step *step, const char *what) {
  snprintf(step->detail, sizeof step->detail, "%s", what);
  return true;
}

/* ---- descriptors and limits ---- */

static bool close_descriptors(struct jail *jail, struct lod_jail_step *step) {
  (void)jail;
  const unsigned first = LOD_WORKER_OUTPUT_FD + 1;
  struct stat output;
  if (fstat(LOD_WORKER_OUTPUT_FD, &output) != 0 || !S_ISDIR(output.st_mode))
    return because(step, "descriptor %d is not the output folder", LOD_WORKER_OUTPUT_FD);
  long limit = sysconf(_SC_OPEN_MAX);
#ifdef SYS_close_range
  if (syscall(SYS_close_range, first, ~0u, 0u) != 0)
#endif
    for (int fd = (int)first; fd < limit && fd < 1 << 20; fd++)
      close(fd);
  for (int fd = (int)first; fd < limit && fd < 4096; fd++)
    if (fcntl(fd, F_GETFD) >= 0)
      return because(step, "descriptor %d stays open", fd);
  return done(step, "0 to 5 are open");
}

static bool lower_limit(int resource, uint64_t value, struct lod_jail_step *step) {
  struct rlimit limit;
  if (getrlimit(resource, &limit) != 0)
    return because(step, "limit %d cannot be read: %s", resource, strerror(errno));
  if (value < limit.rlim_max)
    limit.rlim_max = value;
  /* At the soft limit of processor time comes SIGXCPU, which tells what happened; at the hard one plain SIGKILL. */
  rlim_t soft = resource == RLIMIT_CPU && limit.rlim_max > 1 ? limit.rlim_max - 1 : limit.rlim_max;
  if (limit.rlim_cur > soft)
    limit.rlim_cur = soft;
  struct rlimit after;
  if (setrlimit(resource, &limit) != 0 || getrlimit(resource, &after) != 0 || after.rlim_max > value)
    return because(step, "limit %d cannot be set: %s", resource, strerror(errno));
  return true;
}

static bool set_limits(struct jail *jail, struct lod_jail_step *step) {
  const struct lod_jail_settings *settings = jail->settings;
  /* AddressSanitizer reserves terabytes of shadow. */
  uint64_t memory = SANITIZED ? 0 : settings->max_memory_bytes;
  const struct {
    int resource;
    uint64_t value; /* 0 = as it is, for those that settings may leave alone */
    bool always;
  } limits[] = {
      {RLIMIT_CORE, 0, true},
      {RLIMIT_NOFILE, MAX_FILES, true},
      {RLIMIT_MEMLOCK, 0, true},
      {RLIMIT_MSGQUEUE, 0, true},
      {RLIMIT_DATA, memory, false},
      {RLIMIT_CPU, settings->max_cpu_seconds, false},
      {RLIMIT_FSIZE, settings->max_file_bytes, false},
  };
  for (size_t i = 0; i < sizeof limits / sizeof limits[0]; i++)
    if ((limits[i].always || limits[i].value != 0) && !lower_limit(limits[i].resource, limits[i].value, step))
      return false;
  return done(step, "memory, processor time, file size, descriptors, no core");
}

/* ---- namespaces, root, capabilities ---- */

static bool leave_namespaces(struct jail *jail, struct lod_jail_step *step) {
  const int others = CLONE_NEWNET | CLONE_NEWIPC;
  jail->own_users = unshare(CLONE_NEWUSER | others) == 0;
  if (!jail->own_users && unshare(others) != 0)
    return because(step, "not allowed here: %s", strerror(errno));
  struct stat network;
  if (jail->network.st_ino != 0 && (stat("/proc/self/ns/net", &network) != 0 || network.st_ino == jail->network.st_ino))
    return because(step, "the network is still the old one");
  /* In a user namespace of its own the count begins with this process, so the limit stops thread bombs without touching others. */
  if (jail->own_users && !lower_limit(RLIMIT_NPROC, MAX_PROCESSES, step))
    return false;
  return done(step, jail->own_users ? "own users, network and IPC" : "own network and IPC");
}

static bool change_root(struct jail *jail, struct lod_jail_step *step) {
  struct stat root, output;
  (void)jail;
  if (fchdir(LOD_WORKER_OUTPUT_FD) != 0 || chroot(".") != 0)
    return because(step, "not allowed here: %s", strerror(errno));
  if (stat("/", &root) != 0 || fstat(LOD_WORKER_OUTPUT_FD, &output) != 0 || root.st_dev != output.st_dev || root.st_ino != output.st_ino)
    return because(step, "the root is not the output folder");
  return done(step, "the output folder is the root");
}

static bool drop_capabilities(struct jail *jail, struct lod_jail_step *step) {
  (void)jail;
  for (int capability = 0; capability <= 63; capability++)
    (void)prctl(PR_CAPBSET_DROP, capability, 0, 0, 0); /* needs a capability itself; without one there is nothing to bound */
  (void)prctl(PR_CAP_AMBIENT, PR_CAP_AMBIENT_CLEAR_ALL, 0, 0, 0);
  struct __user_cap_header_struct header = {.version = _LINUX_CAPABILITY_VERSION_3};
  struct __user_cap_data_struct sets[2] = {{0}};
  if (syscall(SYS_capset, &header, sets) != 0)
    return because(step, "capset: %s", strerror(errno));
  memset(sets, 0xff, sizeof sets);
  if (syscall(SYS_capget, &header, sets) != 0)
    return because(step, "capget: %s", strerror(errno));
  for (int i = 0; i < 2; i++)
    if (sets[i].effective != 0 || sets[i].permitted != 0 || sets[i].inheritable != 0)
      return because(step, "some are left");
  return done(step, "none");
}

static bool forbid_privileges(struct jail *jail, struct lod_jail_step *step) {
  (void)jail;
  if (prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) != 0 || prctl(PR_GET_NO_NEW_PRIVS, 0, 0, 0, 0) != 1)
    return because(step, "prctl: %s", strerror(errno));
  /* No core file and no tracer of the same user. */
  if (prctl(PR_SET_DUMPABLE, 0, 0, 0, 0) != 0 || prctl(PR_GET_DUMPABLE, 0, 0, 0, 0) != 0)
    return because(step, "still dumpable");
  return done(step, "set, not dumpable");
}

/* ---- Landlock; the kernel's headers of Debian 12 know an older version than its kernels may have ---- */

enum { LANDLOCK_CREATE_RULESET = 444, LANDLOCK_ADD_RULE = 445, LANDLOCK_RESTRICT_SELF = 446, RULE_PATH_BENEATH = 1, ASK_VERSION = 1 };

struct ruleset {
  uint64_t files, network, scope;
};
struct __attribute__((packed)) path_rule {
  uint64_t allowed;
  int32_t folder_fd;
};

enum file_right {
  WRITE_FILE = 1 << 1,
  READ_FILE = 1 << 2,
  READ_FOLDER = 1 << 3,
  REMOVE_FOLDER = 1 << 4,
  REMOVE_FILE = 1 << 5,
  MAKE_FOLDER = 1 << 7,
  MAKE_FILE = 1 << 8,
  MOVE = 1 << 13,
  TRUNCATE = 1 << 14,
};

static bool restrict_files(struct jail *jail, struct lod_jail_step *step) {
  (void)jail;
  long version = syscall(LANDLOCK_CREATE_RULESET, NULL, 0, ASK_VERSION);
  if (version < 1)
    return because(step, "not in this kernel: %s", strerror(errno));
  /* 13 rights at first; moving since 2, truncating since 3, TCP (2 rights) since 4, devices' ioctl since 5, scopes (2) since 6. */
  int rights = version >= 5 ? 16 : version >= 3 ? 15 : version >= 2 ? 14 : 13;
  const struct ruleset ruleset = {.files = (UINT64_C(1) << rights) - 1, .network = version >= 4 ? 3 : 0, .scope = version >= 6 ? 3 : 0};
  size_t size = version >= 6 ? sizeof ruleset : version >= 4 ? 2 * sizeof(uint64_t) : sizeof(uint64_t);
  int fd = (int)syscall(LANDLOCK_CREATE_RULESET, &ruleset, size, 0);
  if (fd < 0)
    return because(step, "no ruleset: %s", strerror(errno));
  const uint64_t wanted = WRITE_FILE | READ_FILE | READ_FOLDER | REMOVE_FOLDER | REMOVE_FILE | MAKE_FOLDER | MAKE_FILE | MOVE | TRUNCATE;
  const struct path_rule rule = {.allowed = wanted & ruleset.files, .folder_fd = LOD_WORKER_OUTPUT_FD};
  bool restricted = syscall(LANDLOCK_ADD_RULE, fd, RULE_PATH_BENEATH, &rule, 0) == 0 && syscall(LANDLOCK_RESTRICT_SELF, fd, 0) == 0;
  int code = errno;
  close(fd);
  if (!restricted)
    return because(step, "refused: %s", strerror(code));
  snprintf(step->detail, sizeof step->detail, "version %ld, the output folder only", version);
  return true;
}

static bool filter_calls(struct jail *jail, struct lod_jail_step *step) {
  (void)jail;
  if (!lod_jail_filter_load(step->detail, sizeof step->detail))
    return false;
  /* Read back, and try something that is not on the list. */
  if (prctl(PR_GET_SECCOMP, 0, 0, 0, 0) != 2)
    return because(step, "no filter is in place");
  if (syscall(SYS_memfd_create, "probe", 0u) >= 0 || errno != EPERM)
    return because(step, "a forbidden call was let through");
  return done(step, "calls on the list only");
}

/* ---- all together ---- */

enum step_index {
  STEP_DESCRIPTORS,
  STEP_LIMITS,
  STEP_NAMESPACES,
  STEP_ROOT,
  STEP_CAPABILITIES,
  STEP_PRIVILEGES,
  STEP_LANDLOCK,
  STEP_SECCOMP
};

static const struct {
  const char *name;
  bool required;
  step_function *enter;
} kSteps[LOD_JAIL_STEPS] = {
    [STEP_DESCRIPTORS] = {"descriptors", true, close_descriptors},   [STEP_LIMITS] = {"limits", true, set_limits},
    [STEP_NAMESPACES] = {"namespaces", false, leave_namespaces},     [STEP_ROOT] = {"root", false, change_root},
    [STEP_CAPABILITIES] = {"capabilities", true, drop_capabilities}, [STEP_PRIVILEGES] = {"no-new-privileges", true, forbid_privileges},
    [STEP_LANDLOCK] = {"landlock", false, restrict_files},           [STEP_SECCOMP] = {"seccomp", true, filter_calls},
};

/* With Landlock or a new root, what was the root before must be out of reach. */
static bool old_root_is_gone(const struct jail *jail) {
  int fd = open("/", O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (fd < 0)
    return true;
  struct stat facts;
  bool gone = fstat(fd, &facts) == 0 && (facts.st_dev != jail->root.st_dev || facts.st_ino != jail->root.st_ino);
  close(fd);
  return gone;
}

static enum lod_status enter_all(struct jail *jail, struct lod_problem *problem) {
  struct lod_jail_step *steps = jail->report->steps;
  if (stat("/", &jail->root) != 0)
    memset(&jail->root, 0, sizeof jail->root);
  if (stat("/proc/self/ns/net", &jail->network) != 0)
    jail->network.st_ino = 0;
  for (size_t i = 0; i < LOD_JAIL_STEPS; i++) {
    steps[i].state = kSteps[i].enter(jail, &steps[i]) ? LOD_JAIL_ACTIVE : LOD_JAIL_UNAVAILABLE;
    if (steps[i].state == LOD_JAIL_ACTIVE)
      continue;
    if (kSteps[i].required) {
      char type[48];
      snprintf(type, sizeof type, "jail-%s", kSteps[i].name);
      return lod_fail(problem, LOD_UNSUPPORTED, type,
                      "The worker's jail is not complete, so nothing is baked: %s: %s. LODESTREAM_JAIL=none bakes without a jail.",
                      kSteps[i].name, steps[i].detail);
    }
  }
  bool confined = steps[STEP_LANDLOCK].state == LOD_JAIL_ACTIVE || steps[STEP_ROOT].state == LOD_JAIL_ACTIVE;
  if (confined && !old_root_is_gone(jail))
    return lod_fail(problem, LOD_UNSUPPORTED, "jail-landlock", "The worker's jail does not hold: files outside of it can be opened.");
  if (!confined)
    fprintf(stderr, "WARNING: neither Landlock nor a root of its own: a hostile model could make the worker read files of this user.\n");
  for (size_t i = 0; i < LOD_JAIL_STEPS; i++)
    if (steps[i].state != LOD_JAIL_ACTIVE)
      fprintf(stderr, "WARNING: the worker's jail has to do without %s: %s\n", steps[i].name, steps[i].detail);
  return LOD_OK;
}

struct lod_jail_settings lod_jail_defaults(void) {
  return (struct lod_jail_settings){0};
}

enum lod_status lod_jail_enter(const struct lod_jail_settings *settings, struct lod_jail_report *report, struct lod_problem *problem) {
  struct lod_jail_report local;
  if (report == NULL)
    report = &local;
  memset(report, 0, sizeof *report);
  for (size_t i = 0; i < LOD_JAIL_STEPS; i++)
    report->steps[i] = (struct lod_jail_step){.name = kSteps[i].name, .required = kSteps[i].required};
  const char *strategy = settings->strategy != NULL ? settings->strategy : getenv("LODESTREAM_JAIL");
  if (strategy == NULL || strcmp(strategy, "") == 0 || strcmp(strategy, "auto") == 0) {
    report->strategy = "auto";
    struct jail jail = {.settings = settings, .report = report};
    return enter_all(&jail, problem);
  }
  report->strategy = "none";
  if (strcmp(strategy, "none") != 0)
    return lod_fail(problem, LOD_BAD_INPUT, "jail-strategy", "LODESTREAM_JAIL is \"%.40s\"; it may be auto or none.", strategy);
  fprintf(stderr, "WARNING: LODESTREAM_JAIL=none: the worker runs WITHOUT A JAIL. A hostile model can do whatever this user can.\n");
  return LOD_OK;
}

size_t lod_jail_report_json(const struct lod_jail_report *report, char *text, size_t size) {
  static const char *const kStates[] = {"off", "active", "unavailable"};
  size_t length = 0;
#define APPEND(...)                                                                                                                        \
  do {                                                                                                                                     \
    if (length < size)                                                                                                                     \
      length += (size_t)snprintf(text + length, size - length, __VA_ARGS__);                                                               \
  } while (0)
  APPEND("{\"strategy\":\"%s\",\"steps\":{", report->strategy);
  for (size_t i = 0; i < LOD_JAIL_STEPS; i++) {
    const struct lod_jail_step *step = &report->steps[i];
    /* Details are our own sentences and strerror's: nothing in them needs escaping. */
    APPEND("%s\"%s\":{\"state\":\"%s\",\"required\":%s,\"detail\":\"%s\"}", i == 0 ? "" : ",", step->name, kStates[step->state],
           step->required ? "true" : "false", step->detail);
  }
  APPEND("}}");
#undef APPEND
  return length < size ? length : size - 1;
}
