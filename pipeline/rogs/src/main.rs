//! The program `rogs`.

fn main() {}
