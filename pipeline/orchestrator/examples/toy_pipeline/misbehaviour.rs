//! What the words of an episode and tests make stages do besides their work.

#![allow(clippy::disallowed_methods, reason = "files of examples may be left half-written")]

use std::path::PathBuf;
use std::time::Duration;

use rogs_r4c::Record;
use rogs_worker::{Context, StageError, StageResult};

/// Waits where a test wants the run to stand still, once: see the head of `main.rs`.
fn hold(context: &Context<'_>, stage: &str, moment: &str) {
    let place = format!("{}@{stage}@{moment}", context.clip_id());
    let (Some(folder), Ok(wanted)) = (hold_folder(), std::env::var("ROGS_TOY_HOLD")) else {
        return;
    };
    if wanted != place {
        return;
    }
    // Complete before it has its name, so that nobody reads half a number.
    let (number, held) = (folder.join(format!("held-{}", std::process::id())), folder.join("held"));
    if held.exists() || std::fs::write(&number, std::process::id().to_string()).is_err() {
        return;
    }
    let first = std::fs::hard_link(&number, &held).is_ok();
    let _ = std::fs::remove_file(&number);
    while first && !folder.join("release").exists() {
        std::thread::sleep(Duration::from_millis(5));
    }
}

fn hold_folder() -> Option<PathBuf> {
    std::env::var_os("ROGS_TOY_FOLDER").map(PathBuf::from)
}

/// Tells that this worker lives, for as long as it does.
pub(crate) fn keep_alive_lock() {
    let open = |folder: PathBuf| std::fs::File::create(folder.join("alive"));
    if let Some(Ok(file)) = hold_folder().map(open)
        && file.lock_shared().is_ok()
    {
        std::mem::forget(file);
    }
}

/// Writes the output, with a moment behind it at which tests may want to stand.
pub(crate) fn write<T: Record>(context: &mut Context<'_>, stage: &str, record: &T) -> StageResult<()> {
    context.write(record)?;
    hold(context, stage, "end");
    Ok(())
}

/// Does what the episode's words say for this stage; the words travel in the clip's task.
pub(crate) fn misbehave(words: &str, stage: &str, context: &Context<'_>) -> StageResult<()> {
    hold(context, stage, "begin");
    for word in words.split_whitespace() {
        let Some((what, at)) = word.split_once('@') else {
            continue;
        };
        if at != stage {
            continue;
        }
        match what {
            "fail" => {
                return Err(
                    StageError::bad_input(format!("`{}` is made to fail", context.clip_id()))
                        .with_hint("edit the episode"),
                );
            }
            "panic" => panic!("a panic in {stage}"),
            "abort" => std::process::abort(),
            "kill" => drop(
                std::process::Command::new("sh")
                    .args(["-c", &format!("kill -s KILL {}", std::process::id())])
                    .status(),
            ),
            "hang" => std::thread::sleep(Duration::from_secs(600)),
            "stop" => drop(
                std::process::Command::new("sh")
                    .args(["-c", &format!("kill -s STOP {}", std::process::id())])
                    .status(),
            ),
            "memory" => {
                let block = std::hint::black_box(vec![1_u8; 300 << 20]);
                // Where so much is not allowed, Slurm notices within some seconds.
                let allowed = std::env::var("SLURM_MEM_PER_NODE")
                    .ok()
                    .and_then(|text| text.parse().ok());
                if allowed.is_some_and(|mebibytes: u64| mebibytes < 400) {
                    std::thread::sleep(Duration::from_secs(300));
                }
                drop(block);
            }
            "io" => {
                let marker = std::env::temp_dir().join(format!(
                    "rogs-toy-{}-{}",
                    context.clip_id(),
                    std::os::unix::process::parent_id()
                ));
                if std::fs::write(&marker, "").is_ok()
                    && std::fs::hard_link(&marker, marker.with_extension("seen")).is_ok()
                {
                    return Err(StageError::io("the disk hiccups"));
                }
                let _ = (
                    std::fs::remove_file(&marker),
                    std::fs::remove_file(marker.with_extension("seen")),
                );
            }
            _ => return Err(StageError::bad_input(format!("unknown word `{word}`"))),
        }
    }
    Ok(())
}
