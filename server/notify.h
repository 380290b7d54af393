/* What a service manager and the daemon tell each other, after sd_notify(3), sd_listen_fds(3) and sd_watchdog_enabled(3): one datagram a
 * state, and environment variables. Without a manager nothing happens. */
#ifndef LOD_SERVER_NOTIFY_H
#define LOD_SERVER_NOTIFY_H

/* "READY=1", "STOPPING=1", "WATCHDOG=1", "RELOADING=1\nMONOTONIC_USEC=..", "STATUS=..". */
void lod_notify(const char *state);
/* RELOADING=1 with the time that the manager wants with it. */
void lod_notify_reloading(void);
/* The first listening socket that was passed, -1 when none was. The variables are removed: children get no part of it. */
int lod_notify_take_listener(void);
/* The manager wants WATCHDOG=1 at least so often; 0 = it does not watch. */
double lod_notify_watchdog_seconds(void);

#endif
