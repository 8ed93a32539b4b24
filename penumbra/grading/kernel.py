"""What Linux is asked for by number, because the standard library does not name it: Landlock, which
files a process sees, and seccomp, which system calls it may make.

Both hold for a process and all that it ever starts, need no right, and cannot be undone.
Sources: the kernel's Documentation/userspace-api/{landlock,seccomp_filter}.rst and the man pages
landlock(7), seccomp(2), seccomp_unotify(2).
"""

from __future__ import annotations

import ctypes
import errno
import fcntl
import os
import platform
import stat
import struct
from collections.abc import Iterable
from dataclasses import dataclass

_libc = ctypes.CDLL(None, use_errno=True)


def _call(number: int, *arguments: object) -> int:
    """A system call. Raises OSError."""
    result: int = _libc.syscall(ctypes.c_long(number), *arguments)
    if result < 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))
    return result


def prctl(option: int, value: int) -> None:
    """Raises OSError."""
    if _libc.prctl(option, *(ctypes.c_ulong(v) for v in (value, 0, 0, 0))) != 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))


PR_SET_PDEATHSIG, PR_SET_CHILD_SUBREAPER, PR_SET_NO_NEW_PRIVS = 1, 36, 38

# ---------------------------------------------------------------- Landlock: files

_CREATE_RULESET, _ADD_RULE, _RESTRICT_SELF = 444, 445, 446  # the same on every machine
_EXECUTE, _WRITE_FILE, _READ_FILE, _READ_DIR = 1 << 0, 1 << 1, 1 << 2, 1 << 3
_MAKE_CHAR, _MAKE_SOCK, _MAKE_BLOCK = 1 << 6, 1 << 9, 1 << 11
_TRUNCATE, _IOCTL_DEV = 1 << 14, 1 << 15
_OF_FILES = _EXECUTE | _WRITE_FILE | _READ_FILE | _TRUNCATE | _IOCTL_DEV
_EVERY_RIGHT = {1: 13, 2: 14, 3: 15, 4: 15, 5: 16}
"""How many rights to files each version knows; later ones have no more that matter here"""
SCOPES = 6
"""The version from which signals and abstract sockets end at the cage"""
TRUNCATES = 3
"""The version from which truncate(2) is one of the rights"""


def landlock_version() -> int:
    """0 if the kernel has none, or it is switched off."""
    try:
        return _call(_CREATE_RULESET, None, ctypes.c_size_t(0), ctypes.c_uint(1))
    except OSError:
        return 0


def landlock(read: Iterable[str], write: Iterable[str]) -> None:
    """From here on nothing is opened, listed, run or changed but what lies in these folders and
    files; what is not there is left out. Metadata and links can still be read, modes changed.

    PR_SET_NO_NEW_PRIVS must be set. Raises OSError.
    """
    version = landlock_version()
    every = (1 << _EVERY_RIGHT[min(version, max(_EVERY_RIGHT))]) - 1
    attributes = struct.pack("QQQ", every, 0b11, 0b11)  # TCP too; abstract sockets and signals
    size = 8 if version < 4 else 16 if version < SCOPES else 24
    rules = _call(_CREATE_RULESET, attributes[:size], ctypes.c_size_t(size), ctypes.c_uint(0))
    reads = _EXECUTE | _READ_FILE | _READ_DIR
    writes = every & ~(_MAKE_CHAR | _MAKE_SOCK | _MAKE_BLOCK | _IOCTL_DEV)
    try:
        for paths, rights in ((read, reads), (write, writes)):
            for path in paths:
                _allow(rules, path, rights)
        _call(_RESTRICT_SELF, ctypes.c_int(rules), ctypes.c_uint(0))
    finally:
        os.close(rules)


def _allow(rules: int, path: str, rights: int) -> None:
    try:
        place = os.open(path, os.O_PATH | os.O_CLOEXEC)
    except FileNotFoundError:
        return
    try:
        if not stat.S_ISDIR(os.fstat(place).st_mode):
            rights &= _OF_FILES
        beneath = struct.pack("=Qi", rights, place)
        _call(_ADD_RULE, ctypes.c_int(rules), ctypes.c_int(1), beneath, ctypes.c_uint(0))
    finally:
        os.close(place)


# ---------------------------------------------------------------- seccomp: system calls

_SET_MODE_FILTER, _NEW_LISTENER = 1, 8
_KILL, _ERRNO, _NOTIFY, _ALLOW = 0x8000_0000, 0x0005_0000, 0x7FC0_0000, 0x7FFF_0000
_LOAD, _EQUAL, _GREATER_OR_EQUAL, _ANY_BIT, _AND, _RETURN = 0x20, 0x15, 0x35, 0x45, 0x54, 0x06

_NUMBERS: dict[str, tuple[int, int]] = {
    # name: x86-64, aarch64 (-1: it has none)
    "accept": (43, 202), "accept4": (288, 242), "add_key": (248, 217), "bind": (49, 200),
    "bpf": (321, 280), "chmod": (90, -1), "chown": (92, -1), "chroot": (161, 51),
    "clone": (56, 220), "clone3": (435, 435), "connect": (42, 203), "fallocate": (285, 47),
    "fanotify_init": (300, 262), "fchmodat": (268, 53), "fchmodat2": (452, 452),
    "fchown": (93, 55), "fchownat": (260, 54), "fcntl": (72, 25), "fremovexattr": (199, 16),
    "fsconfig": (431, 431), "fsetxattr": (190, 7), "fsmount": (432, 432), "fsopen": (430, 430),
    "fspick": (433, 433), "futimesat": (261, -1), "io_uring_enter": (426, 426),
    "io_uring_register": (427, 427), "io_uring_setup": (425, 425), "ioprio_set": (251, 30),
    "kcmp": (312, 272), "kexec_load": (246, 104), "keyctl": (250, 219), "kill": (62, 129),
    "lchown": (94, -1), "listen": (50, 201), "lremovexattr": (198, 15), "lsetxattr": (189, 6),
    "memfd_create": (319, 279), "memfd_secret": (447, 447), "migrate_pages": (256, 238),
    "modify_ldt": (154, -1), "mount": (165, 40), "mount_setattr": (442, 442),
    "move_mount": (429, 429), "move_pages": (279, 239), "mq_open": (240, 180),
    "mq_unlink": (241, 181), "msgctl": (71, 187), "msgget": (68, 186), "msgrcv": (70, 188),
    "msgsnd": (69, 189), "name_to_handle_at": (303, 264), "open_by_handle_at": (304, 265),
    "open_tree": (428, 428), "perf_event_open": (298, 241), "pidfd_getfd": (438, 438),
    "pidfd_open": (434, 434), "pidfd_send_signal": (424, 424), "pivot_root": (155, 41),
    "prlimit64": (302, 261), "process_madvise": (440, 440), "process_vm_readv": (310, 270),
    "process_vm_writev": (311, 271), "ptrace": (101, 117), "quotactl": (179, 60),
    "removexattr": (197, 14), "request_key": (249, 218), "rt_sigqueueinfo": (129, 138),
    "rt_tgsigqueueinfo": (297, 240), "sched_setaffinity": (203, 122),
    "sched_setattr": (314, 274), "sched_setparam": (142, 118), "sched_setscheduler": (144, 119),
    "semctl": (66, 191), "semget": (64, 190), "semop": (65, 193), "semtimedop": (220, 192),
    "setns": (308, 268), "setpgid": (109, 154), "setpriority": (141, 140), "setsid": (112, 157),
    "setxattr": (188, 5), "shmat": (30, 196), "shmctl": (31, 195), "shmget": (29, 194),
    "socket": (41, 198), "socketpair": (53, 199), "syslog": (103, 116), "tgkill": (234, 131),
    "tkill": (200, 130), "truncate": (76, 45), "umount2": (166, 39), "unshare": (272, 97),
    "userfaultfd": (323, 282), "utime": (132, -1), "utimensat": (280, 88), "utimes": (235, -1),
}  # fmt: skip
_UNKNOWN = 463
"""From here on calls are newer than this list (Linux 6.11), and refused as if the kernel were too
old; so are those of x86-64's 32-bit twin, from 2^30"""
_MACHINES = {"x86_64": (0xC000_003E, 317), "aarch64": (0xC000_00B7, 277)}
"""AUDIT_ARCH, and seccomp's own number"""

_AF_UNIX, _SOCK_DGRAM, _SOCKET_KIND = 1, 2, 0xF
_CLONE_NEW = 0x7E02_0000  # every namespace that clone can make
_F_SETOWN, _F_SETSIG, _F_SETOWN_EX = 8, 10, 15


@dataclass(frozen=True)
class _Test:
    """Of one argument of a call: the rule holds if its 32 bits pass."""

    argument: int
    value: int
    how: int = _EQUAL
    fails: bool = False
    """the rule holds if they do not pass"""
    mask: int = 0xFFFF_FFFF
    high: bool = False
    """the upper 32 bits, of an address"""


def filter_works() -> bool:
    """This machine is one of those whose system calls are listed."""
    return platform.machine() in _MACHINES


def filter_program(namespaces: bool, landlock: int = 0, notify: bool = False) -> bytes:
    """What a caged program may ask the kernel for, as seccomp's program.

    namespaces: processes, files and the like have namespaces of their own; otherwise more is
    refused, and less the higher the version of Landlock is. notify: changes of mode by path are
    left to whoever listens (Listener).
    """
    rules: list[tuple[int, str, _Test | None]] = []

    def refuse(how: int, names: str, *tests: _Test) -> None:
        rules.extend((how, name, test) for name in names.split() for test in tests or (None,))

    no, none = _ERRNO | errno.EPERM, _ERRNO | errno.ENOSYS
    # A network, another's memory: nothing honest does it, so that is what it is ended for. Name
    # services and displays, which libraries look for by themselves, are local sockets.
    refuse(no, "socket", _Test(0, _AF_UNIX))
    refuse(_KILL, "socket ptrace process_vm_readv process_vm_writev")
    # A pair is connected to itself, unless it is of datagrams, which can be sent elsewhere.
    refuse(no, "socketpair", _Test(0, _AF_UNIX, fails=True))
    refuse(no, "socketpair", _Test(1, _SOCK_DGRAM, mask=_SOCKET_KIND))
    refuse(no, "connect bind listen accept accept4")
    # Memory and disk that no limit sees. Without clone3 programs use clone, whose flags are seen.
    refuse(none, "memfd_create memfd_secret io_uring_setup io_uring_enter io_uring_register clone3")
    refuse(_ERRNO | errno.EOPNOTSUPP, "fallocate")  # a disk is full at once, before it is seen
    refuse(none, "shmget shmat shmctl semget semop semtimedop semctl")
    refuse(none, "msgget msgsnd msgrcv msgctl mq_open mq_unlink")
    # Other namespaces, and what most of the kernel's holes need.
    refuse(no, "clone", _Test(0, _CLONE_NEW, _ANY_BIT))
    refuse(no, "unshare setns mount umount2 pivot_root chroot open_tree move_mount fsopen fsconfig")
    refuse(no, "fsmount fspick mount_setattr bpf perf_event_open userfaultfd kexec_load quotactl")
    refuse(no, "add_key request_key keyctl name_to_handle_at open_by_handle_at fanotify_init kcmp")
    refuse(no, "syslog modify_ldt pidfd_getfd process_madvise")
    if not namespaces:
        # One group of processes, which ends at once, and nothing done to those of others.
        refuse(no, "setsid setpgid pidfd_open pidfd_send_signal migrate_pages move_pages")
        others = _Test(0, 0, fails=True)
        refuse(no, "prlimit64 sched_setaffinity sched_setattr sched_setparam", others)
        refuse(no, "sched_setscheduler", others)
        refuse(no, "setpriority ioprio_set", _Test(1, 0, fails=True))
        # What Landlock leaves to a file's owner. Times are left as they are without a word, since
        # make, ar and tar set them by path.
        refuse(no, "chown lchown fchown fchownat")
        refuse(_ERRNO | errno.EOPNOTSUPP, "setxattr lsetxattr fsetxattr")
        refuse(_ERRNO | errno.EOPNOTSUPP, "removexattr lremovexattr fremovexattr")
        named = _Test(1, 0, fails=True), _Test(1, 0, fails=True, high=True)
        refuse(_ERRNO, "utime utimes futimesat")
        refuse(_ERRNO, "utimensat", *named)
        if notify:
            refuse(_NOTIFY, "chmod fchmodat fchmodat2")
        if landlock < TRUNCATES:
            refuse(no, "truncate")
        if landlock < SCOPES:
            refuse(no, "kill tkill tgkill rt_sigqueueinfo rt_tgsigqueueinfo")
            for command in (_F_SETOWN, _F_SETSIG, _F_SETOWN_EX):
                refuse(no, "fcntl", _Test(1, command))
    return _assembled(rules)


def _assembled(rules: list[tuple[int, str, _Test | None]]) -> bytes:
    """One block a rule: another call jumps over it. seccomp(2): struct seccomp_data."""
    machine = platform.machine()
    column = list(_MACHINES).index(machine)
    number, arch = 0, 4
    code: list[tuple[int, int, int, int]] = [  # code, jump if true, if false, value
        (_LOAD, 0, 0, arch), (_EQUAL, 1, 0, _MACHINES[machine][0]), (_RETURN, 0, 0, _KILL),
        (_LOAD, 0, 0, number), (_GREATER_OR_EQUAL, 0, 1, _UNKNOWN),
        (_RETURN, 0, 0, _ERRNO | errno.ENOSYS),
    ]  # fmt: skip
    for action, name, test in rules:
        call = _NUMBERS[name][column]
        if call < 0:
            continue
        if test is None:
            code += [(_EQUAL, 0, 1, call), (_RETURN, 0, 0, action)]
            continue
        jumps = (1, 0) if test.fails else (0, 1)
        code += [
            (_EQUAL, 0, 5, call),
            (_LOAD, 0, 0, 16 + 8 * test.argument + 4 * test.high),
            (_AND, 0, 0, test.mask),
            (test.how, *jumps, test.value),
            (_RETURN, 0, 0, action),
            (_LOAD, 0, 0, number),
        ]
    code.append((_RETURN, 0, 0, _ALLOW))
    return b"".join(struct.pack("=HBBI", *line) for line in code)


def seccomp(program: bytes, listen: bool = False) -> int:
    """Filter this process's calls from here on. listen: a descriptor for a Listener, else 0.

    PR_SET_NO_NEW_PRIVS must be set. Raises OSError.
    """
    text = ctypes.create_string_buffer(program, len(program))
    argument = struct.pack("HxxxxxxQ", len(program) // 8, ctypes.addressof(text))
    return _call(
        _MACHINES[platform.machine()][1],
        ctypes.c_uint(_SET_MODE_FILTER),
        ctypes.c_uint(_NEW_LISTENER if listen else 0),
        argument,
    )


# ---------------------------------------------------------------- changes of mode, on its behalf

_RECEIVE, _SEND, _STILL_VALID = 0xC050_2100, 0xC018_2101, 0x4008_2102
_OPENAT2 = 437
_NO_MAGICLINKS, _NO_SYMLINKS, _BENEATH = 0x02, 0x04, 0x08
_AT_FDCWD = -100
_LONGEST = 4096  # PATH_MAX


class Listener:
    """Does chmod for a program that Landlock holds and that is of our own user, whose every file it
    could otherwise close or open to others: only in its own folders, and only the nine bits.

    What it asks for is read once and done here, so it cannot be another thing by then.
    """

    def __init__(self, descriptor: int, folders: Iterable[str]) -> None:
        self.descriptor = descriptor
        self.folders = [os.path.realpath(folder) for folder in folders]

    def answer(self) -> None:
        """One request."""
        request = bytearray(80)
        try:
            fcntl.ioctl(self.descriptor, _RECEIVE, request)
        except OSError:  # who asked is dead
            return
        number, process = struct.unpack_from("QI", request)
        call = struct.unpack_from("i", request, 16)[0]
        arguments = struct.unpack_from("6Q", request, 32)
        try:
            self._change(number, process, call, arguments)
            error = 0
        except OSError as refused:
            error = -(refused.errno or errno.EPERM)
        try:
            fcntl.ioctl(self.descriptor, _SEND, struct.pack("QqiI", number, 0, error, 0))
        except OSError:
            return

    def _change(self, number: int, process: int, call: int, arguments: tuple[int, ...]) -> None:
        if call in _NUMBERS["chmod"]:
            folder, address, mode, flags = _AT_FDCWD, arguments[0], arguments[1], 0
        else:
            folder, address, mode = arguments[0], arguments[1], arguments[2]
            flags = arguments[3] if call in _NUMBERS["fchmodat2"] else 0
            folder = struct.unpack("i", struct.pack("I", folder & 0xFFFF_FFFF))[0]
        if flags:
            raise OSError(errno.EOPNOTSUPP, "flags")
        with open(f"/proc/{process}/mem", "rb", 0) as memory:
            memory.seek(address)
            path = os.fsdecode(_text(memory.read(_LONGEST - address % _LONGEST) or b"", memory))
        at = f"/proc/{process}/cwd" if folder == _AT_FDCWD else f"/proc/{process}/fd/{folder}"
        where = os.path.realpath(os.path.join(os.readlink(at), path))
        fcntl.ioctl(self.descriptor, _STILL_VALID, struct.pack("Q", number))  # it was that process
        for own in self.folders:
            if os.path.commonpath([own, where]) == own:
                _change_mode(own, os.path.relpath(where, own), mode & 0o777)
                return
        raise OSError(errno.EPERM, "not its own")


def _text(first: bytes, memory: object) -> bytes:
    """Up to the zero, which may be on the next page."""
    if b"\0" not in first:
        first += memory.read(_LONGEST)  # type: ignore[attr-defined]
    text, end, _ = first.partition(b"\0")
    if not end or not text:
        raise OSError(errno.ENOENT, "no path")
    return text


def _change_mode(folder: str, path: str, mode: int) -> None:
    """Of a file in a folder, reached through no link. Raises OSError."""
    root = os.open(folder, os.O_PATH | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        how = struct.pack(
            "QQQ", os.O_PATH | os.O_CLOEXEC, 0, _BENEATH | _NO_SYMLINKS | _NO_MAGICLINKS
        )
        file = _call(_OPENAT2, ctypes.c_int(root), os.fsencode(path), how, ctypes.c_size_t(24))
        try:
            os.chmod(f"/proc/self/fd/{file}", mode)
        finally:
            os.close(file)
    finally:
        os.close(root)
