/* Loaded before the C library into the software-in-the-loop firmware: a virtual CLOCK_MONOTONIC, and loopback only.
 *
 * The firmware's main thread is the only one that moves the clock: a look at it costs LOOK_NS, a sleep what is slept.
 * It runs freely up to JAXPLAN_BOOT_S seconds, then stands until a radio packet and a state packet that carry the same
 * later time have both been dealt with, and runs up to that time. Whenever it stands, what it told the motors last is
 * sent, once: a packet after the boot, then one for each pair, whatever the machine does meanwhile. Other threads
 * see the clock without moving it. Without JAXPLAN_BOOT_S time is real, for the command line.
 *
 * Two more things it sees to: sockets that would listen on all interfaces listen on 127.0.0.1, and the process dies
 * with the one that started it (JAXPLAN_PARENT).
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <math.h>
#include <netinet/in.h>
#include <pthread.h>
#include <signal.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/select.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

enum { STATE, RADIO, KINDS };
enum { STATE_BYTES = 18 * 8, RADIO_BYTES = 8 + 16 * 2, MOTOR_BYTES = 4 * 4 };
enum { PORT_MOTORS_RAW = 9001, PORT_MOTORS = 9002 };
#define SECOND 1000000000ULL
#define LOOK_NS 1000 /* arbitrary: the firmware polls, so a look must cost something */

static int is_virtual;
static pthread_t main_thread;

static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static pthread_cond_t released = PTHREAD_COND_INITIALIZER;
/* Under the lock: */
static uint64_t now_ns, limit_ns;
static uint64_t dealt_with[KINDS]; /* time stamp of the newest packet that a receiving thread is done with */
static int answer_due = 1;         /* what released the clock has no motor packet yet; the first says: booted */
static int motor_socket = -1;
static struct sockaddr_in motor_peer;
static unsigned char motors[MOTOR_BYTES];

static __thread int received = -1; /* what this thread received and is dealing with */
static __thread uint64_t received_ns;

static int (*real_clock_gettime)(clockid_t, struct timespec *);
static int (*real_nanosleep)(const struct timespec *, struct timespec *);
static int (*real_select)(int, fd_set *, fd_set *, fd_set *, struct timeval *);
static int (*real_bind)(int, const struct sockaddr *, socklen_t);
static ssize_t (*real_recvfrom)(int, void *, size_t, int, struct sockaddr *, socklen_t *);
static ssize_t (*real_sendto)(int, const void *, size_t, int, const struct sockaddr *, socklen_t);

static void *next(const char *name)
{
    void *found = dlsym(RTLD_NEXT, name);
    if (!found) _exit(127);
    return found;
}

__attribute__((constructor)) static void begin(void)
{
    const char *boot = getenv("JAXPLAN_BOOT_S"), *parent = getenv("JAXPLAN_PARENT");
    real_clock_gettime = next("clock_gettime");
    real_nanosleep = next("nanosleep");
    real_select = next("select");
    real_bind = next("bind");
    real_recvfrom = next("recvfrom");
    real_sendto = next("sendto");
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    if (parent && getppid() != (pid_t)atol(parent)) _exit(126); /* it was gone already */
    main_thread = pthread_self();
    if (boot) {
        is_virtual = 1;
        limit_ns = (uint64_t)llround(atof(boot) * 1e9);
    }
}

static int in_main(void)
{
    return pthread_equal(pthread_self(), main_thread);
}

static void advance(uint64_t ns)
{
    pthread_mutex_lock(&lock);
    while (ns > 0) {
        uint64_t step = limit_ns - now_ns < ns ? limit_ns - now_ns : ns;
        now_ns += step;
        ns -= step;
        if (ns == 0) break;
        if (answer_due && motor_socket >= 0) {
            real_sendto(motor_socket, motors, MOTOR_BYTES, 0, (struct sockaddr *)&motor_peer, sizeof motor_peer);
            answer_due = 0;
        }
        pthread_cond_wait(&released, &lock);
    }
    pthread_mutex_unlock(&lock);
}

/* This thread waits for its next packet, so it is done with the last. */
static void done_with_packet(void)
{
    if (received < 0) return;
    pthread_mutex_lock(&lock);
    dealt_with[received] = received_ns;
    if (dealt_with[STATE] == dealt_with[RADIO] && received_ns > limit_ns) {
        limit_ns = received_ns;
        answer_due = 1;
        pthread_cond_broadcast(&released);
    }
    pthread_mutex_unlock(&lock);
    received = -1;
}

int clock_gettime(clockid_t clock, struct timespec *out)
{
    if (!is_virtual || clock != CLOCK_MONOTONIC) return real_clock_gettime(clock, out);
    if (in_main()) advance(LOOK_NS);
    pthread_mutex_lock(&lock);
    out->tv_sec = now_ns / SECOND;
    out->tv_nsec = now_ns % SECOND;
    pthread_mutex_unlock(&lock);
    return 0;
}

int nanosleep(const struct timespec *wanted, struct timespec *left)
{
    if (!is_virtual || !in_main()) return real_nanosleep(wanted, left);
    advance((uint64_t)wanted->tv_sec * SECOND + (uint64_t)wanted->tv_nsec);
    return 0;
}

int select(int count, fd_set *in, fd_set *out, fd_set *odd, struct timeval *timeout)
{
    done_with_packet();
    return real_select(count, in, out, odd, timeout);
}

ssize_t recvfrom(int fd, void *data, size_t size, int flags, struct sockaddr *from, socklen_t *length)
{
    ssize_t count = real_recvfrom(fd, data, size, flags, from, length);
    if (is_virtual && !in_main() && (count == STATE_BYTES || count == RADIO_BYTES)) {
        double stamp;
        memcpy(&stamp, data, sizeof stamp);
        if (stamp > 0.0 && stamp < 1e9) {
            received = count == STATE_BYTES ? STATE : RADIO;
            received_ns = (uint64_t)llround(stamp * 1e9);
        }
    }
    return count;
}

ssize_t sendto(int fd, const void *data, size_t size, int flags, const struct sockaddr *to, socklen_t length)
{
    int port = to && to->sa_family == AF_INET ? ntohs(((const struct sockaddr_in *)to)->sin_port) : 0;
    if (!is_virtual || (port != PORT_MOTORS && port != PORT_MOTORS_RAW))
        return real_sendto(fd, data, size, flags, to, length);
    if (port == PORT_MOTORS && size == MOTOR_BYTES) {
        pthread_mutex_lock(&lock);
        motor_socket = fd;
        memcpy(&motor_peer, to, sizeof motor_peer);
        if (in_main()) memcpy(motors, data, MOTOR_BYTES); /* a receiving thread would race with the main thread */
        pthread_mutex_unlock(&lock);
    }
    return (ssize_t)size;
}

int bind(int fd, const struct sockaddr *address, socklen_t length)
{
    union {
        struct sockaddr_in v4;
        struct sockaddr_in6 v6;
    } own;
    if (length > sizeof own) return real_bind(fd, address, length);
    memcpy(&own, address, length);
    if (address->sa_family == AF_INET && own.v4.sin_addr.s_addr == htonl(INADDR_ANY))
        own.v4.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    if (address->sa_family == AF_INET6 && IN6_IS_ADDR_UNSPECIFIED(&own.v6.sin6_addr)) {
        unsigned char *bytes = own.v6.sin6_addr.s6_addr; /* 127.0.0.1, as version 6 writes it */
        bytes[10] = bytes[11] = 0xff;
        bytes[12] = 127;
        bytes[15] = 1;
    }
    return real_bind(fd, (struct sockaddr *)&own, length);
}
