//! Steps that are not idle, as `keep_ranges_1_0_1.json` lists them by the place of an episode.

use rogs_worker::StageResult;
use serde_json::Value;

use super::super::tree;
use super::tables::{Tables, Wanted, numbers};

/// Steps that are not idle, by `FOLDER--FILE` of an episode: `[[start, end), ...]`. The version is in the name.
const KEPT: &str = "keep_ranges";

/// `keep_ranges_1_0_1.json`
pub(super) fn is_kept(name: &str) -> bool {
    name.starts_with(KEPT) && name.ends_with(".json")
}

/// Steps of an episode that are not idle, as intervals that end before their second number; `None` where it is not
/// listed.
pub(super) fn find(tables: &Tables, place: Option<&str>) -> StageResult<Option<Vec<[usize; 2]>>> {
    let names = tables.names()?;
    let (Some(place), Some(name)) = (place, names.iter().find(|name| is_kept(name))) else {
        return Ok(None);
    };
    let here = |key: &str| {
        let folder = key.split("--").next().unwrap_or(key);
        tree::place_within(folder).as_deref() == Some(place)
    };
    let Some((_, value)) = tables.find(name, Wanted::Named(&here))? else {
        return Ok(None);
    };
    let pair = |pair: &Value| {
        let [start, end] = <[f64; 2]>::try_from(numbers(pair)?).ok()?;
        let whole = |number: f64| (0.0..1e9).contains(&number) && number.fract() == 0.0;
        (whole(start) && whole(end) && start <= end).then_some([start as usize, end as usize])
    };
    let ranges: Option<Vec<[usize; 2]>> = value.as_array().and_then(|pairs| pairs.iter().map(pair).collect());
    ranges
        .map(Some)
        .ok_or_else(|| tables.wrong(name, format!("the entry of {place} is no list of [start, end)")))
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn ranges_that_are_kept_are_joined_by_place() {
        let folder = tempfile::tempdir().unwrap();
        let at = |time: &str| format!("gs://x/r2d2/LAB/success/2023-07-07/{time}");
        let key = |time: &str| format!("{}/recordings/MP4--{}/trajectory.h5", at(time), at(time));
        let table =
            json!({key("Fri_Jul__7_09:42:23_2023"): [[3, 40], [50, 61]], key("Fri_Jul__7_10:00:00_2023"): [[5, 2]]});
        rogs_files::write_bytes(
            &folder.path().join("keep_ranges_1_0_1.json"),
            table.to_string().as_bytes(),
        )
        .unwrap();
        let tables = Tables::of(folder.path());
        let kept = |place: &str| find(&tables, Some(place));
        let here = "LAB/success/2023-07-07/Fri_Jul_7_09_42_23_2023";
        assert_eq!(kept(here).unwrap(), Some(vec![[3, 40], [50, 61]]));
        assert_eq!(kept("LAB/failure/2023-07-07/Fri_Jul_7_09_42_23_2023").unwrap(), None);
        let error = kept("LAB/success/2023-07-07/Fri_Jul_7_10_00_00_2023").unwrap_err();
        assert!(error.message.contains("no list of [start, end)"), "{error}");
    }
}
