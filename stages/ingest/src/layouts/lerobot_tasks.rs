//! Texts of the tasks of a LeRobot data set that are kept by number.

use serde::Deserialize;

use super::lerobot_episodes::Lines;
use super::lerobot_meta::{Dataset, Version};
use super::parquet_table::{Table, Work};

impl Dataset {
    /// The text of a task by its number, from `meta/tasks.parquet` (v3.0) or `meta/tasks.jsonl` (v2.1); empty when there is
    /// none: it is text for people.
    pub(crate) fn task(&self, number: u64) -> String {
        let found = match self.version {
            Version::V30 => self.task_of_table(number),
            Version::V21 => self.task_of_lines(number),
        };
        found.unwrap_or_default()
    }

    fn task_of_table(&self, number: u64) -> Option<String> {
        let path = self.root.join("meta/tasks.parquet");
        // pandas keeps the text as the index of the table, whose column has one name or the other.
        const NAMES: [&str; 3] = ["task", "__index_level_0__", "tasks"];
        let wanted = |name: &str| name == "task_index" || NAMES.contains(&name);
        let table = Table::read_where(&path, &wanted, Some(("task_index", number)), &mut Work::default()).ok()?;
        let texts = NAMES.iter().find_map(|name| table.texts(name).ok())?;
        texts.first().cloned()
    }

    fn task_of_lines(&self, number: u64) -> Option<String> {
        #[derive(Deserialize)]
        struct Task {
            task_index: u64,
            task: String,
        }
        let mut lines = Lines::open(&self.root.join("meta/tasks.jsonl")).ok()?;
        let mut work = Work::default();
        while let Some((_, line)) = lines.next(&mut work).ok()? {
            match rogs_schemas::json::read::<Task>(&line) {
                Ok(task) if task.task_index == number => return Some(task.task),
                _ => {}
            }
        }
        None
    }
}
