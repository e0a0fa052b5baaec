//! Joints, grippers and times.

use crate::cases::{Cases, Failure, Warning, altered};

#[test]
fn joints_grippers_and_times() {
    let mut cases = Cases::new();
    let set = |row: usize, column: usize, value: &str| {
        let value = value.to_owned();
        move |rows: &mut Vec<Vec<String>>| rows[row][column] = value
    };
    cases.states(
        "nan",
        Failure("joint `panda_joint2` is NaN at row 3", ""),
        set(4, 2, "nan"),
    );
    cases.states(
        "inf",
        Failure("joint `panda_joint1` is -inf at row 0", ""),
        set(1, 1, "-inf"),
    );
    cases.states("cells", Failure("row 1 has 8 cells, the header 9", ""), |rows| {
        drop(rows[2].pop())
    });
    cases.states("dof", Failure("there is no column `panda_joint7`", ""), |rows| {
        rows.iter_mut().for_each(|row| drop(row.remove(7)));
    });
    cases.states(
        "degrees",
        Failure("joint `panda_joint4` is -105", "were these degrees?"),
        |rows| {
            rows.iter_mut().skip(1).for_each(|row| row[4] = "-105.2".into());
        },
    );
    cases.states("limits", Warning("joint `panda_joint4` leaves its limits"), |rows| {
        rows.iter_mut().skip(1).for_each(|row| row[4] = "0.4".into());
    });
    cases.states("order", Warning("is the order of the joints right?"), |rows| {
        rows.iter_mut().skip(1).for_each(|row| row.swap(2, 4));
    });
    cases.states(
        "open",
        Failure("the gripper is 1.5 at row 2, it must be in 0 (open) to 1 (closed)", ""),
        set(3, 8, "1.5"),
    );
    cases.states("width", Failure("the gripper is -0.2 at row 0", ""), set(1, 8, "-0.2"));
    cases.states(
        "nan-gripper",
        Failure("the gripper is NaN at row 0", ""),
        set(1, 8, "nan"),
    );
    cases.states(
        "short",
        Failure("there are 16 rows, the episode has 17 frames", ""),
        |rows| drop(rows.pop()),
    );
    cases.states(
        "back",
        Failure("the time 0.01 at row 2 does not ascend", ""),
        set(3, 0, "0.01"),
    );
    cases.states("twice", Failure("at row 3 does not ascend", ""), |rows| {
        rows[4][0] = rows[3][0].clone()
    });
    cases.states(
        "milliseconds",
        Failure("the times step by 66.", "were these milliseconds?"),
        |rows| {
            for row in rows.iter_mut().skip(1) {
                row[0] = (1000.0 * row[0].parse::<f64>().unwrap()).to_string();
            }
        },
    );
    cases.edited(
        "rate",
        Failure("but 30 frames a second step by 0.0333 s", "correct `fps`"),
        |episode| episode["fps"] = 30.into(),
    );
    cases.states(
        "gap",
        Warning("frames are missing at 1 place, the longest gap is 0.267 s before row 9"),
        |rows| {
            for row in rows.iter_mut().skip(10) {
                row[0] = (0.2 + row[0].parse::<f64>().unwrap()).to_string();
            }
        },
    );
    cases.check();
    // Times that the clip does not have.
    let workspace = &cases.workspace;
    let (code, said) = altered(workspace, "[ingest]\n", "[ingest]\nquery = [17]\n");
    assert_eq!(code, Some(1), "{said}");
    assert!(said.contains("`query` frame 17 is not below `frames` 17"), "{said}");
}
