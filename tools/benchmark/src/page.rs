//! The page: a section a part, in Markdown.

use std::fmt::Write as _;

use crate::table::Table;

/// Sections: a title, and its tables or why there are none.
pub(crate) fn page(sections: &[(&str, Result<Vec<Table>, String>)]) -> String {
    let mut page = String::new();
    for (title, found) in sections {
        let _ = writeln!(page, "## {title}\n");
        match found {
            Ok(tables) => {
                for table in tables {
                    table.write(&mut page);
                    page.push('\n');
                }
            }
            Err(missing) => {
                let _ = writeln!(page, "Left out: {missing}.\n");
            }
        }
    }
    page.truncate(page.trim_end().len());
    page.push('\n');
    page
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::table::Cell;

    #[test]
    fn a_part_without_data_is_left_out_with_its_reason() {
        let mut table = Table::new("what", &["mm"]);
        table.row("robot", [Cell::of(Some(1.26), 1)]);
        table.row("table", [Cell::of(None, 1)]);
        let sections = [
            ("A real robot cell", Ok(vec![table])),
            ("Real rooms", Err("`rooms` is not there".to_owned())),
        ];
        assert_eq!(
            page(&sections),
            "## A real robot cell\n\n| what | mm |\n| --- | --- |\n| robot | 1.3 |\n| table | - |\n\n## Real rooms\n\n\
             Left out: `rooms` is not there.\n"
        );
    }
}
