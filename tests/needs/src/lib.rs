//! Tests that need something a machine may lack, and long ones: `cargo test` reports them as ignored, with the reason.
//!
//! ```ignore
//! #[needs(shared, ffmpeg)]
//! #[test]
//! fn a_recorded_episode_becomes_a_clip() {
//!     let episode = shared!("data/droid_ctrlworld/new_setup");
//! }
//!
//! #[needs(long = "100 rounds of kills")]
//! #[test]
//! fn a_hundred_kills_lose_nothing() {}
//! ```
//!
//! What is there is looked up while the test is compiled, because the test harness has no way to skip a test that runs. So a
//! test compiled where something was missing stays ignored after that has been installed, until `touch
//! tests/needs/src/lib.rs`; one compiled where it was there fails where it is gone. A change of the environment variables
//! below is noticed.
//!
//! | need | what it is |
//! |---|---|
//! | `shared` | the folder of reference data: `ROGS_SHARED`, else `shared` beside the checkout |
//! | `ffmpeg` | `ffmpeg` and `ffprobe` on the `PATH` |
//! | `libx264` | an `ffmpeg` that encodes H.264 |
//! | `parallel` | GNU parallel |
//! | `numpy`, `pillow`, `opencv`, `zstandard`, `hyperqueue`, `pinocchio` | the package of `ROGS_PEER_PYTHON` (else `python3`) |
//! | `plyfile`, `pycolmap`, `fourdgs` | the same |
//! | `qemu` | `qemu-x86_64-static`, which emulates processors, on an x86-64 machine |
//! | `bash` | the shell |
//! | `chromium` | the browser, on the `PATH` |
//! | `node` | `node`, and what `npm ci` installs in `pipeline/report/viewer` |
//! | `cc` | a C compiler |
//! | `mount` | the right to mount a file system |
//! | `slurm` | root, and the programs of Slurm and munge |
//! | `long = "why"` | time: `ROGS_LONG_TESTS=1` |

mod probe;

use proc_macro::{Delimiter, TokenStream, TokenTree};

/// Environment variables that decide; a test is compiled anew when one of them changes.
const VARIABLES: [&str; 3] = ["ROGS_SHARED", "ROGS_PEER_PYTHON", "ROGS_LONG_TESTS"];

/// Ignores the test below when a need is not there; stands above `#[test]`. See the crate for the needs.
#[proc_macro_attribute]
pub fn needs(arguments: TokenStream, test: TokenStream) -> TokenStream {
    match expand(arguments, &test) {
        Ok(mut expanded) => {
            expanded.extend(test);
            expanded
        }
        Err(wrong) => {
            let mut expanded = source(&format!("::core::compile_error!({wrong:?});"));
            expanded.extend(test);
            expanded
        }
    }
}

/// A path below the folder of reference data: `shared!("data/lpips")` is a `PathBuf`, there or not.
#[proc_macro]
pub fn shared(path: TokenStream) -> TokenStream {
    let root = probe::shared_root();
    source(&format!(
        "{{ const _: ::core::option::Option<&str> = ::core::option_env!(\"ROGS_SHARED\"); \
         ::std::path::Path::new({root:?}).join({path}) }}"
    ))
}

/// What comes before the test: what makes cargo look again, and `#[ignore]` when something is missing.
fn expand(arguments: TokenStream, test: &TokenStream) -> Result<TokenStream, String> {
    if !is_test(test) {
        return Err("`#[needs(...)]` stands above `#[test]`".to_owned());
    }
    let mut missing = Vec::new();
    let mut tokens = arguments.into_iter();
    while let Some(token) = tokens.next() {
        let need = token.to_string();
        let mut why = String::new();
        for token in tokens.by_ref() {
            match &token {
                TokenTree::Punct(punct) if punct.as_char() == ',' => break,
                TokenTree::Punct(punct) if punct.as_char() == '=' => {}
                _ => token.to_string().trim_matches('"').clone_into(&mut why),
            }
        }
        missing.extend(probe::missing(&need, &why)?);
    }
    let watched: String = VARIABLES
        .iter()
        .map(|name| format!("const _: ::core::option::Option<&str> = ::core::option_env!({name:?});"))
        .collect();
    let ignore = match missing.is_empty() {
        true => String::new(),
        false => format!("#[ignore = {:?}]", missing.join("; ")),
    };
    Ok(source(&(watched + &ignore)))
}

/// Whether an item has the attribute `#[test]`, which must be expanded after ours to see `#[ignore]`.
fn is_test(item: &TokenStream) -> bool {
    item.clone().into_iter().any(|token| match token {
        TokenTree::Group(group) if group.delimiter() == Delimiter::Bracket => group.stream().to_string() == "test",
        _ => false,
    })
}

/// Tokens of our own text, which always are tokens.
fn source(text: &str) -> TokenStream {
    text.parse().unwrap_or_default()
}
