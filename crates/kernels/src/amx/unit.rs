//! The instructions. Rust has no stable functions for them, so they are written as assembly.

use std::arch::asm;
use std::arch::x86_64::{__cpuid, __cpuid_count};
use std::cell::Cell;

use super::{Block, HINTS, Kind, STEP, TILE_ROWS, WORD};

thread_local! {
    /// Rows of the blocks that this thread's tiles have the shapes for; 0 for none. The shapes last from block to block, since
    /// loading them takes as long as a small block.
    static SHAPED: Cell<usize> = const { Cell::new(0) };
}

/// Rows and bytes of each tile: what `ldtilecfg` reads.
#[repr(C, align(64))]
struct Shapes([u8; 64]);

impl Shapes {
    /// Returns the shapes for a block whose tiles have `first` and `second` rows of activations.
    fn new(first: usize, second: usize) -> Self {
        let mut shapes = [0; 64];
        shapes[0] = 1; // the only palette: eight tiles
        let rows = [first, first, second, second, first, second, TILE_ROWS, TILE_ROWS];
        for (tile, rows) in rows.into_iter().enumerate().filter(|(_, rows)| *rows > 0) {
            shapes[16 + 2 * tile] = STEP as u8; // the upper byte of its u16 is 0
            shapes[48 + tile] = rows as u8;
        }
        Self(shapes)
    }
}

/// Returns true if the processor has tiles for both formats and Linux permits their use.
pub fn permitted() -> bool {
    const ARCH_PRCTL: i64 = 158;
    const ARCH_REQ_XCOMP_PERM: i64 = 0x1023;
    const XFEATURE_XTILEDATA: i64 = 18;
    const NEEDED: u32 = 1 << 22 | 1 << 24 | 1 << 25; // AMX-BF16, AMX-TILE, AMX-INT8
    if __cpuid(0).eax < 7 || __cpuid_count(7, 0).edx & NEEDED != NEEDED {
        return false;
    }
    let status: i64;
    // SAFETY: a system call that takes no pointer and only permits a larger register state. It clobbers the registers
    // that are named.
    unsafe {
        asm!(
            "syscall",
            inlateout("rax") ARCH_PRCTL => status,
            in("rdi") ARCH_REQ_XCOMP_PERM,
            in("rsi") XFEATURE_XTILEDATA,
            out("rcx") _,
            out("r11") _,
            options(nostack),
        );
    }
    status == 0
}

/// Gives up this thread's tiles, which the system would otherwise save whenever it suspends the thread.
pub fn release() {
    if SHAPED.replace(0) > 0 {
        // SAFETY: changes tiles alone, which nothing uses until [`multiply`] shapes them again. It shaped these, so the unit is
        // there and permitted.
        unsafe { asm!("tilerelease", options(nostack, nomem)) };
    }
}

/// As [`super::multiply`], in the unit.
///
/// # Safety
/// As [`super::multiply`]; [`permitted`] returned true.
pub unsafe fn multiply(kind: Kind, block: &Block, rows: usize, vectors: usize) {
    // Two tiles of about the same height; one instruction takes as many cycles as its tile has rows.
    let first = if rows > TILE_ROWS { rows.div_ceil(2) } else { rows };
    if SHAPED.get() != rows {
        let shapes = Shapes::new(first, rows - first);
        // SAFETY: reads the 64 bytes of `shapes`, which describe tiles that the processor has; nothing else uses tiles.
        unsafe { asm!("ldtilecfg [{}]", in(reg) shapes.0.as_ptr(), options(nostack)) };
        SHAPED.set(rows);
    }
    let line = vectors * STEP;
    let second = block.out.wrapping_add(first * block.ldc);
    /// Clears the sums, runs the steps and stores the sums.
    macro_rules! run {
        ([$($clear:literal)*] [$($step:expr),*] [$($store:literal)*]) => {
            // SAFETY: the tiles have the shapes for `rows` rows, so the loads read the rows and lines that the caller guarantees; a
            // panel of one vector is read by the forms of one tile alone. The stores write the result that the caller guarantees.
            // The registers that change are named; nothing else uses tiles.
            unsafe {
                asm!(
                    $($clear,)*
                    "2:",
                    $($step,)*
                    "prefetcht1 [{next}]",
                    "prefetcht1 [{next} + 64]",
                    "prefetcht1 [{next} + 128]",
                    "prefetcht1 [{next} + 192]",
                    "add {next}, {hints}",
                    "add {a}, 64",
                    "add {a2}, 64",
                    "add {b}, {lines}",
                    "dec {steps}",
                    "jnz 2b",
                    $($store,)*
                    "/* {second} */", // not every form stores there
                    a = inout(reg) block.a => _,
                    a2 = inout(reg) block.a.wrapping_add(first * block.lda) => _,
                    b = inout(reg) block.b => _,
                    steps = inout(reg) block.steps => _,
                    next = inout(reg) block.next.at() => _,
                    hints = in(reg) HINTS * block.next.step(),
                    lda = in(reg) block.lda,
                    line = in(reg) line,
                    lines = in(reg) TILE_ROWS * line,
                    sums = in(reg) block.out,
                    second = in(reg) second,
                    width = in(reg) block.ldc * WORD,
                    out("tmm0") _, out("tmm1") _, out("tmm2") _, out("tmm3") _,
                    out("tmm4") _, out("tmm5") _, out("tmm6") _, out("tmm7") _,
                    options(nostack),
                );
            }
        };
    }
    /// The form for a number of tiles of rows and of columns. Tiles 0 to 3 are sums, 4 and 5 activations, 6 and 7
    /// weights. The second tile of columns lies 64 bytes to the right.
    macro_rules! form {
        ($dot:literal, 1, 1) => {
            run!(
                ["tilezero tmm0"]
                [
                    "tileloadd tmm4, [{a} + {lda}]",
                    "tileloadd tmm6, [{b} + {line}]",
                    concat!($dot, " tmm0, tmm4, tmm6")
                ]
                ["tilestored [{sums} + {width}], tmm0"]
            )
        };
        ($dot:literal, 1, 2) => {
            run!(
                ["tilezero tmm0" "tilezero tmm1"]
                [
                    "tileloadd tmm4, [{a} + {lda}]",
                    "tileloadd tmm6, [{b} + {line}]",
                    "tileloadd tmm7, [{b} + {line} + 64]",
                    concat!($dot, " tmm0, tmm4, tmm6"),
                    concat!($dot, " tmm1, tmm4, tmm7")
                ]
                ["tilestored [{sums} + {width}], tmm0" "tilestored [{sums} + {width} + 64], tmm1"]
            )
        };
        ($dot:literal, 2, 1) => {
            run!(
                ["tilezero tmm0" "tilezero tmm2"]
                [
                    "tileloadd tmm4, [{a} + {lda}]",
                    "tileloadd tmm6, [{b} + {line}]",
                    "tileloadd tmm5, [{a2} + {lda}]",
                    concat!($dot, " tmm0, tmm4, tmm6"),
                    concat!($dot, " tmm2, tmm5, tmm6")
                ]
                ["tilestored [{sums} + {width}], tmm0" "tilestored [{second} + {width}], tmm2"]
            )
        };
        ($dot:literal, 2, 2) => {
            run!(
                ["tilezero tmm0" "tilezero tmm1" "tilezero tmm2" "tilezero tmm3"]
                [
                    "tileloadd tmm4, [{a} + {lda}]",
                    "tileloadd tmm6, [{b} + {line}]",
                    "tileloadd tmm7, [{b} + {line} + 64]",
                    concat!($dot, " tmm0, tmm4, tmm6"),
                    "tileloadd tmm5, [{a2} + {lda}]",
                    concat!($dot, " tmm1, tmm4, tmm7"),
                    concat!($dot, " tmm2, tmm5, tmm6"),
                    concat!($dot, " tmm3, tmm5, tmm7")
                ]
                [
                    "tilestored [{sums} + {width}], tmm0"
                    "tilestored [{sums} + {width} + 64], tmm1"
                    "tilestored [{second} + {width}], tmm2"
                    "tilestored [{second} + {width} + 64], tmm3"
                ]
            )
        };
    }
    match (kind, rows > TILE_ROWS, vectors) {
        (Kind::Half, false, 1) => form!("tdpbf16ps", 1, 1),
        (Kind::Half, false, _) => form!("tdpbf16ps", 1, 2),
        (Kind::Half, true, 1) => form!("tdpbf16ps", 2, 1),
        (Kind::Half, true, _) => form!("tdpbf16ps", 2, 2),
        (Kind::Byte, false, 1) => form!("tdpbusd", 1, 1),
        (Kind::Byte, false, _) => form!("tdpbusd", 1, 2),
        (Kind::Byte, true, 1) => form!("tdpbusd", 2, 1),
        (Kind::Byte, true, _) => form!("tdpbusd", 2, 2),
    }
}
