//! Which machine makes the same bits: that with the vector instructions and the mathematical library of the one that made
//! the goldens.

use std::fmt::Write as _;
use std::path::PathBuf;

/// Where it is written down.
pub(crate) fn file() -> PathBuf {
    crate::outputs().join("machine.txt")
}

/// True when this machine must give the bits of the goldens.
pub(crate) fn made_the_goldens() -> bool {
    let theirs = std::fs::read_to_string(file()).unwrap_or_default();
    let same = theirs == describe();
    if !same {
        println!(
            "another machine: compared within tolerances\ngoldens: {theirs}here: {}",
            describe()
        );
    }
    same
}

/// What decides about last bits.
pub(crate) fn describe() -> String {
    let mut text = format!("architecture {}\nvectors", std::env::consts::ARCH);
    for (name, there) in vectors() {
        if there {
            let _ = write!(text, " {name}");
        }
    }
    let _ = writeln!(text, "\nmathematics {:016x}", mathematics());
    text
}

#[cfg(target_arch = "x86_64")]
fn vectors() -> Vec<(&'static str, bool)> {
    vec![
        ("avx2", std::arch::is_x86_feature_detected!("avx2")),
        ("fma", std::arch::is_x86_feature_detected!("fma")),
        ("avx512f", std::arch::is_x86_feature_detected!("avx512f")),
        ("avx512bf16", std::arch::is_x86_feature_detected!("avx512bf16")),
    ]
}

#[cfg(not(target_arch = "x86_64"))]
fn vectors() -> Vec<(&'static str, bool)> {
    Vec::new()
}

/// A digest of what the functions of the C library return, whose last bits differ between its versions.
fn mathematics() -> u64 {
    let mut digest = 0xcbf2_9ce4_8422_2325_u64;
    let mut add = |bits: u64| digest = (digest ^ bits).wrapping_mul(0x0100_0000_01b3);
    for step in 1..2000 {
        let x = std::hint::black_box(f64::from(step) * 0.0137 - 9.1);
        let y = x as f32;
        for value in [
            x.sin(),
            x.cos(),
            x.exp(),
            x.abs().ln(),
            x.atan(),
            x.tanh(),
            x.abs().powf(0.37),
        ] {
            add(value.to_bits());
        }
        for value in [
            y.sin(),
            y.cos(),
            y.exp(),
            y.abs().ln(),
            y.atan(),
            y.tanh(),
            y.abs().powf(0.37),
        ] {
            add(u64::from(value.to_bits()));
        }
    }
    digest
}
