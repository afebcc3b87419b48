"""Why a serial port cannot be opened, as a finding."""

import errno

from hostlink.diagnosis.finding import Finding, finding

_CODES = {
    errno.EACCES: "serial_permission",
    errno.EPERM: "serial_permission",
    errno.ENOENT: "serial_missing",
    errno.ENODEV: "serial_missing",
    errno.ENXIO: "serial_missing",
    errno.EBUSY: "serial_busy",
    errno.EAGAIN: "serial_busy",
}


def port_finding(error: OSError) -> Finding:
    """The error's number gives the code, its text the detail."""
    return finding(_CODES.get(error.errno or 0, "serial_unusable"), error.strerror or str(error))
