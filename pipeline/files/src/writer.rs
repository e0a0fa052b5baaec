//! Who writes: names of temporaries that say so, and whether that process may still be at work.

use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// For so long after its last change nobody takes away what a process elsewhere was writing: no file of ours takes
/// longer, and no two clocks differ by more.
pub(crate) const LEASE: Duration = Duration::from_secs(24 * 3600);

/// Eight hexadecimal digits for all processes that see each other by their numbers: one running system, and in it one
/// space of process numbers (containers have their own).
pub(crate) fn place() -> &'static str {
    static PLACE: OnceLock<String> = OnceLock::new();
    PLACE.get_or_init(|| {
        let read = |path: &str| std::fs::read_to_string(path).unwrap_or_default();
        let numbers = std::fs::read_link("/proc/self/ns/pid").unwrap_or_default();
        let text = format!(
            "{}\0{}\0{}",
            read("/proc/sys/kernel/hostname"),
            read("/proc/sys/kernel/random/boot_id"),
            numbers.display()
        );
        // FNV-1a, 32 bits: a name, not a proof.
        let hash = (text.bytes()).fold(0x811c_9dc5_u32, |hash, byte| {
            (hash ^ u32::from(byte)).wrapping_mul(0x0100_0193)
        });
        format!("{hash:08x}")
    })
}

/// Whoever made a temporary file or folder, by its name.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Writer<'a> {
    /// Number of the process.
    pub(crate) process: u32,
    /// The [`place`] that the number is of; `None` in names of earlier versions.
    pub(crate) place: Option<&'a str>,
}

impl<'a> Writer<'a> {
    /// The writer in `.NAME.PID.PLACE.tmp` or `.NAME.PID-N.PLACE.tmp`.
    pub(crate) fn of(name: &'a str) -> Option<Self> {
        let stem = name.strip_prefix('.')?.strip_suffix(".tmp")?;
        let number = |text: &str| text.split('-').next()?.parse().ok();
        let (rest, last) = stem.rsplit_once('.')?;
        let is_place = last.len() == 8 && last.bytes().all(|byte| byte.is_ascii_hexdigit());
        let placed = is_place.then(|| rest.rsplit_once('.')).flatten();
        if let Some(process) = placed.and_then(|(_, process)| number(process)) {
            return Some(Self {
                process,
                place: Some(last),
            });
        }
        Some(Self {
            process: number(last)?,
            place: None,
        })
    }

    /// True for this process.
    fn is_me(&self) -> bool {
        self.process == std::process::id() && self.place == Some(place())
    }

    /// Whether the writer may still be at work on `file`. Processes that can be seen from here are looked up; others hold
    /// a lease that ends [`LEASE`] after the last change of the file.
    pub(crate) fn may_be_at_work(&self, file: &Path) -> bool {
        if self.place == Some(place()) && Path::new("/proc/self").exists() {
            return is_running_since(self.process, changed(file));
        }
        let age = changed(file).and_then(|changed| SystemTime::now().duration_since(changed).ok());
        age.is_none_or(|age| age < LEASE)
    }
}

/// The temporary names of this process for something at `path`, in the order in which they are tried.
pub(crate) fn temporaries(folder: &Path, name: &str) -> impl Iterator<Item = PathBuf> {
    let (folder, start) = (folder.to_owned(), format!(".{name}.{}", std::process::id()));
    // A process that was killed may have had our number and left its file behind.
    (0..1000).map(move |attempt| match attempt {
        0 => folder.join(format!("{start}.{}.tmp", place())),
        attempt => folder.join(format!("{start}-{attempt}.{}.tmp", place())),
    })
}

/// Removes what this process has left beside `path` while writing it. For the end of a writer that cannot unwind.
pub fn remove_own(path: &Path) {
    let Some(name) = path.file_name().and_then(|name| name.to_str()) else {
        return;
    };
    for entry in std::fs::read_dir(crate::paths::folder_of(path))
        .into_iter()
        .flatten()
        .flatten()
    {
        let file = entry.file_name();
        let Some(file) = file.to_str() else { continue };
        let ours = file
            .strip_prefix('.')
            .and_then(|rest| rest.strip_prefix(name)?.strip_prefix('.'));
        let plain = ours.is_some_and(|rest| rest.split('.').count() == 3);
        if plain && Writer::of(file).is_some_and(|writer| writer.is_me()) {
            let is_folder = entry.file_type().is_ok_and(|kind| kind.is_dir());
            let _ = if is_folder {
                std::fs::remove_dir_all(entry.path())
            } else {
                std::fs::remove_file(entry.path())
            };
        }
    }
}

/// When something at a path was last changed, links not followed.
fn changed(path: &Path) -> Option<SystemTime> {
    std::fs::symlink_metadata(path).and_then(|found| found.modified()).ok()
}

/// Whether a process of that number runs and did so before the last change of its file. Numbers are used again, and a
/// killed process keeps its number until its parent has taken note.
pub(crate) fn is_running_since(process: u32, changed: Option<SystemTime>) -> bool {
    let Ok(stat) = std::fs::read_to_string(format!("/proc/{process}/stat")) else {
        return false;
    };
    // `PID (NAME) STATE ...`; the name may hold spaces and parentheses.
    let Some((_, fields)) = stat.rsplit_once(") ") else {
        return true;
    };
    let fields: Vec<&str> = fields.split(' ').collect();
    if matches!(fields.first(), Some(&"Z" | &"X")) {
        return false;
    }
    // Field 22 of the whole line: start in hundredths of a second after boot.
    let started = fields
        .get(19)
        .and_then(|ticks| ticks.parse::<f64>().ok())
        .map(|ticks| ticks / 100.0);
    let booted = std::fs::read_to_string("/proc/stat").ok().and_then(|stat| {
        stat.lines()
            .find_map(|line| line.strip_prefix("btime ")?.trim().parse::<f64>().ok())
    });
    let changed = changed.and_then(|time| Some(time.duration_since(UNIX_EPOCH).ok()?.as_secs_f64()));
    match (started, booted, changed) {
        // The boot time is given in whole seconds.
        (Some(started), Some(booted), Some(changed)) => booted + started <= changed + 2.0,
        _ => true,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_tell_their_writers() {
        let writer = |process, place| Some(Writer { process, place });
        assert_eq!(Writer::of(".a.r4c.12.0011aabb.tmp"), writer(12, Some("0011aabb")));
        assert_eq!(Writer::of(".a.r4c.12-3.0011aabb.tmp"), writer(12, Some("0011aabb")));
        assert_eq!(Writer::of(".a.r4c.12.tmp"), writer(12, None));
        for other in ["a.r4c.12.tmp", ".hidden.tmp", ".a.r4c", ".a.0011aabb"] {
            assert_eq!(Writer::of(other), None, "{other}");
        }
        let own = temporaries(Path::new("f"), "a.r4c").nth(2).unwrap();
        let own = own.file_name().unwrap().to_str().unwrap();
        assert!(Writer::of(own).unwrap().is_me(), "{own}");
    }

    #[test]
    fn only_what_is_ours_of_that_name_is_removed() {
        let scratch = tempfile::tempdir().unwrap();
        let (me, here) = (std::process::id(), place());
        let names = [
            format!(".a.r4c.{me}.{here}.tmp"),
            format!(".a.r4c.{me}-1.{here}.tmp"),
            format!(".a.r4c.b.{me}.{here}.tmp"),
            format!(".a.r4c.{me}.00000000.tmp"),
            format!(".b.r4c.{me}.{here}.tmp"),
        ];
        for name in &names {
            std::fs::write(scratch.path().join(name), "x").unwrap();
        }
        remove_own(&scratch.path().join("a.r4c"));
        let left = names.iter().filter(|name| scratch.path().join(name).exists());
        assert_eq!(left.collect::<Vec<_>>(), names[2..].iter().collect::<Vec<_>>());
    }
}
