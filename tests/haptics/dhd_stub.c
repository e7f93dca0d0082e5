/* The Force Dimension functions that are bound, with one device of which a test sets and reads the numbers. */
#include <stdlib.h>
#include <string.h>

double stub_position[3], stub_force[3], stub_max_force = -1.0;
int stub_homed, stub_fails, stub_open, stub_stopped, stub_gravity = -1, stub_forces_on = -1, stub_major = 3, stub_code;
unsigned int stub_buttons;
signed char stub_identity;

static int answer(signed char identity) {
    stub_identity = identity;
    return stub_fails || identity != 5 ? -1 : stub_code;
}
void dhdGetSDKVersion(int *major, int *minor, int *release, int *revision) { *major = stub_major; *minor = 17; *release = 5; *revision = 1; }
int dhdOpenType(int type) { if (type != 60 || stub_fails) return -1; stub_open = 1; return 5; }
int dhdGetStatus(int status[16], signed char identity) { memset(status, 0, 16 * sizeof status[0]); status[3] = stub_homed; return answer(identity); }
int dhdGetPosition(double *x, double *y, double *z, signed char identity) { *x = stub_position[0]; *y = stub_position[1]; *z = stub_position[2]; return answer(identity); }
int dhdSetForce(double x, double y, double z, signed char identity) { stub_force[0] = x; stub_force[1] = y; stub_force[2] = z; return answer(identity); }
unsigned int dhdGetButtonMask(signed char identity) { (void)identity; return stub_buttons; }
int dhdEnableForce(unsigned char value, signed char identity) { stub_forces_on = value; return answer(identity); }
int dhdSetGravityCompensation(int value, signed char identity) { stub_gravity = value; return answer(identity); }
int dhdSetMaxForce(double limit, signed char identity) { stub_max_force = limit; return answer(identity); }
int dhdStop(signed char identity) { stub_stopped = 1; return answer(identity); }
int dhdClose(signed char identity) { stub_open = 0; return answer(identity); }
const char *dhdErrorGetLastStr(void) { return "no device found"; }
