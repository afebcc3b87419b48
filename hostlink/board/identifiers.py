"""C++ names for the names of a definition: the same, unless C++ or Arduino.h has another meaning for them. Pure."""

from collections.abc import Iterable
from functools import cache
from importlib.resources import files
from typing import Final

_KEYWORDS: Final = """
    alignas alignof and and_eq asm auto bitand bitor bool break case catch char char16_t char32_t char8_t class
    co_await co_return co_yield compl concept const const_cast consteval constexpr constinit continue decltype default
    delete do double dynamic_cast else enum explicit export extern false float for friend goto if inline int long
    mutable namespace new noexcept not not_eq nullptr operator or or_eq private protected public register
    reinterpret_cast requires return short signed sizeof static static_assert static_cast struct switch template this
    thread_local throw true try typedef typeid typename union unsigned using virtual void volatile wchar_t while xor
    xor_eq
"""
# Macros without arguments of Arduino.h and of what it includes: a field or a constant of that name does not compile.
# Macros with arguments (min, max, abs) do no harm: no "(" ever stands behind a member. macros.txt has those of the AVRs
# and of the C libraries, out of their headers (tools/board_macros.py); these are of SAM, ESP8266, ESP32 and compilers.
_MACROS: Final = """
    ANALOG BIT0 BIT1 BIT2 BIT3 BIT4 BIT5 BIT6 BIT7 BIT8 BIT9 BIT10 BIT11 BIT12 BIT13 BIT14 BIT15 BIT16 BIT17 BIT18 BIT19
    BIT20 BIT21 BIT22 BIT23 BIT24 BIT25 BIT26 BIT27 BIT28 BIT29 BIT30 BIT31 CHIPID CPU2X ESP32 ESP8266 ESP_FAIL ESP_OK
    FUNCTION_0 FUNCTION_1 FUNCTION_2 FUNCTION_3 FUNCTION_4 FUNCTION_5 FUNCTION_6 GPC GPE GPF GPI GPIE GPMUX GPO
    ICACHE_FLASH_ATTR ICACHE_RAM_ATTR INPUT_PULLDOWN_16 IOSWAP IRAM_ATTR LOCAL MAC0 MAC1 ONHIGH ONHIGH_WE ONLOW ONLOW_WE
    OPEN_DRAIN PULLDOWN PULLUP PWMRANGE RTCCV RTCSV SPECIAL STORE_ATTR T1C T1I T1L T1V T2A T2C T2I T2L T2V TIM_EDGE
    TIM_LEVEL TIM_LOOP TIM_SINGLE U0A U0C0 U0C1 U0D U0F U0S U1A U1C0 U1C1 U1D U1F U1S UIS WAKEUP_PULLDOWN WAKEUP_PULLUP
    ROS_IN_FLASH
    DAC DISABLED DMAC EFC0 EFC1 FALSE GPBR I2C INPUT_PULLDOWN MATRIX OUTPUT_OPEN_DRAIN PIOA PIOB PIOC PIOD PMC PWM RSTC
    RTC RTT SMC SPI SUPC TC0 TC1 TC2 TRNG TRUE TWI0 TWI1 UART UNUSED UOTGHS USART0 USART1 USART2 USART3 WDT arm avr i386
    int16_t int32_t int64_t int8_t linux uint16_t uint32_t uint64_t uint8_t unix
"""
# Functions and classes of Arduino's cores and of C that a package could be named like: its namespace cannot be.
_GLOBALS: Final = """
    Client EEPROM ESP Ethernet Print Printable SPI Serial Serial_ Server Servo Stream String UDP WiFi Wire abort abs
    accept access alarm basename bind boolean byte ceil clock close connect crypt daemon delay div dup encrypt equals
    exit exp floor fork free gamma index init j0 j1 kill lgamma link listen log loop main malloc map micros millis mount
    nice open optarg pause pipe poll pow printf puts raise rand random read remainder remove rename revoke rewind round
    scanf select send setup shutdown signal sin sleep socket sqrt square stat stderr stdin stdout swab sync system tan
    time tone trunc truncate wait word write y0 y1 yield
"""
METHODS: Final = ("serialize", "deserialize", "getType", "getMD5", "getSize")  # of each message's class


@cache
def _reserved() -> frozenset[str]:
    of_headers = files("hostlink.board").joinpath("macros.txt").read_text()
    return frozenset((_KEYWORDS + _MACROS + of_headers).split())


@cache
def _global_names() -> frozenset[str]:
    return frozenset(_GLOBALS.split())


class Names:
    """Gives each name of one class once: a name that is in use or means something else gets a _ behind it."""

    def __init__(self, used: Iterable[str] = ()) -> None:
        self._used = set(used)

    def add(self, name: str) -> str:
        """The C++ name for it."""
        name = identifier(name)
        while name in self._used:
            name += "_"
        self._used.add(name)
        return name


def identifier(name: str) -> str:
    """The name, or with a _ behind it where it is a keyword or a macro."""
    return f"{name}_" if name in _reserved() else name


def class_identifier(base: str) -> str:
    """As `identifier`, for a class with METHODS."""
    return f"{base}_" if base in METHODS else identifier(base)


def namespace(package: str) -> str:
    """As `identifier`, for a package."""
    name = identifier(package)
    while name in _global_names():
        name += "_"
    return name


def class_name(full_name: str) -> str:
    """ "std_msgs/Header" -> "::std_msgs::Header"."""
    package, _, base = full_name.partition("/")
    return f"::{namespace(package)}::{class_identifier(base)}"
