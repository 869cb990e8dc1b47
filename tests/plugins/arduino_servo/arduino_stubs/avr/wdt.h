// The chip's own watchdog: it only counts who feeds it.
#pragma once
#define WDTO_250MS 4
extern int stub_wdt, stub_wdt_resets;
inline void wdt_enable(int timeout) { stub_wdt = timeout; }
inline void wdt_disable() { stub_wdt = -1; }
inline void wdt_reset() { stub_wdt_resets++; }
