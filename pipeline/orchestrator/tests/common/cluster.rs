//! A real Slurm on this host in a folder of its own: munge, one controller, two nodes of two cores, a pretended GPU each.
//!
//! Needs root and the packages `slurm-wlm slurm-wlm-basic-plugins munge` (the need `slurm` of `rogs-needs`); no systemd,
//! control groups, database or accounts. Tests fail where the daemons do not come up.
#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]
#![allow(dead_code, unreachable_pub)]

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::time::{Duration, Instant};

/// A running cluster; stopped when the last test lets go of it.
pub struct Cluster {
    folder: tempfile::TempDir,
}

/// The cluster that tests at work share, or why there is none.
static SHARED: Mutex<Result<Weak<Cluster>, String>> = Mutex::new(Ok(Weak::new()));

/// Waits for something that happens on any machine, however slow; the limit only turns a hang into a failure.
pub fn wait_until(what: &str, mut happened: impl FnMut() -> bool) {
    let start = Instant::now();
    while !happened() {
        assert!(start.elapsed() < Duration::from_secs(900), "waited in vain for {what}");
        std::thread::sleep(Duration::from_millis(100));
    }
}

/// A test at a time: one that waits holds the cluster already, so that it is started once.
static TURN: Mutex<()> = Mutex::new(());

/// The cluster while it is one test's turn.
pub struct Turn {
    pub cluster: Arc<Cluster>,
    _turn: MutexGuard<'static, ()>,
}

impl Cluster {
    /// The cluster for one test.
    pub fn get() -> Turn {
        let cluster = Self::shared();
        Turn {
            cluster,
            _turn: TURN.lock().unwrap_or_else(PoisonError::into_inner),
        }
    }

    fn shared() -> Arc<Self> {
        let mut shared = SHARED.lock().unwrap_or_else(PoisonError::into_inner);
        let found = match &*shared {
            Ok(weak) => match weak.upgrade() {
                Some(cluster) => Ok(cluster),
                None => Self::start().map(Arc::new),
            },
            Err(why) => Err(why.clone()),
        };
        match found {
            Ok(cluster) => {
                *shared = Ok(Arc::downgrade(&cluster));
                cluster
            }
            Err(why) => {
                *shared = Err(why.clone());
                panic!("no Slurm to test with: {why}");
            }
        }
    }

    fn start() -> Result<Self, String> {
        let cluster = Self {
            folder: tempfile::tempdir().map_err(|error| error.to_string())?,
        };
        cluster.write_configuration()?;
        let root = cluster.folder.path();
        let path = |name: &str| root.join(name).display().to_string();
        cluster.daemon(
            "munged",
            &[
                "--force",
                &format!("--key-file={}", path("munge/key")),
                &format!("--socket={}", path("munge/sock")),
                &format!("--pid-file={}", path("munge/pid")),
                &format!("--log-file={}", path("log/munged.log")),
                &format!("--seed-file={}", path("munge/seed")),
            ],
        )?;
        cluster.daemon("slurmctld", &["-c"])?;
        cluster.daemon("slurmd", &["-N", "n1", "-c"])?;
        cluster.daemon("slurmd", &["-N", "n2", "-c"])?;
        let start = Instant::now();
        loop {
            let states = cluster
                .try_ask("sinfo", &["-h", "-N", "-o", "%T"])
                .unwrap_or_else(|why| why);
            if states.lines().count() == 2 && states.lines().all(|state| state == "idle") {
                return Ok(cluster);
            }
            if start.elapsed() > Duration::from_secs(90) {
                let log = std::fs::read_to_string(root.join("log/slurmctld.log")).unwrap_or_default();
                let last: Vec<&str> = log.lines().rev().take(5).collect();
                return Err(format!("its nodes do not come up ({states:?}): {last:?}"));
            }
            std::thread::sleep(Duration::from_millis(200));
        }
    }

    fn write_configuration(&self) -> Result<(), String> {
        let root = self.folder.path();
        let why = |error: std::io::Error| error.to_string();
        for folder in ["munge", "state", "spool/n1", "spool/n2", "log"] {
            std::fs::create_dir_all(root.join(folder)).map_err(why)?;
        }
        let random = std::fs::File::open("/dev/urandom").map_err(why)?;
        let mut key = Vec::new();
        std::io::Read::read_to_end(&mut std::io::Read::take(random, 1024), &mut key).map_err(why)?;
        std::fs::write(root.join("munge/key"), key).map_err(why)?;
        command("chmod", &["700", &root.display().to_string()])?;
        command("chmod", &["700", &root.join("munge").display().to_string()])?;
        command("chmod", &["600", &root.join("munge/key").display().to_string()])?;
        let host = output("hostname", &["-s"])?;
        let [controller, n1, n2] = free_ports().map_err(why)?;
        let root = root.display();
        let text = format!(
            "ClusterName=ci\nSlurmctldHost={host}(127.0.0.1)\nSlurmUser=root\nSlurmdUser=root\n\
             CommunicationParameters=NoCtldInAddrAny,NoInAddrAny\nSlurmctldPort={controller}\n\
             AuthType=auth/munge\nAuthInfo=socket={root}/munge/sock\nCryptoType=crypto/munge\n\
             ProctrackType=proctrack/linuxproc\nTaskPlugin=task/none\nSwitchType=switch/none\nMpiDefault=none\n\
             JobAcctGatherType=jobacct_gather/linux\nJobAcctGatherFrequency=task=1\n\
             JobAcctGatherParams=OverMemoryKill\nAccountingStorageType=accounting_storage/none\n\
             JobCompType=jobcomp/filetxt\nJobCompLoc={root}/log/jobcomp.txt\nSelectType=select/cons_tres\n\
             SelectTypeParameters=CR_Core_Memory\nSchedulerType=sched/backfill\n\
             SchedulerParameters=sched_interval=1,bf_interval=1,batch_sched_delay=0,sched_min_interval=0\n\
             KillWait=2\nReturnToService=2\nMinJobAge=3600\nMessageTimeout=90\nTCPTimeout=30\nDependencyParameters=kill_invalid_depend\n\
             SlurmdParameters=config_overrides\nStateSaveLocation={root}/state\nSlurmdSpoolDir={root}/spool/%n\n\
             SlurmctldPidFile={root}/slurmctld.pid\nSlurmdPidFile={root}/slurmd.%n.pid\n\
             SlurmctldLogFile={root}/log/slurmctld.log\nSlurmdLogFile={root}/log/slurmd.%n.log\nGresTypes=gpu\n\
             NodeName=n1 NodeHostname={host} NodeAddr=127.0.0.1 Port={n1} CPUs=2 RealMemory=8000 Gres=gpu:1 State=UNKNOWN\n\
             NodeName=n2 NodeHostname={host} NodeAddr=127.0.0.1 Port={n2} CPUs=2 RealMemory=8000 Gres=gpu:1 State=UNKNOWN\n\
             PartitionName=batch Nodes=n1,n2 Default=YES MaxTime=INFINITE State=UP\n"
        );
        std::fs::write(self.configuration(), text).map_err(why)?;
        std::fs::write(
            self.folder.path().join("gres.conf"),
            "NodeName=n[1-2] Name=gpu File=/dev/null\n",
        )
        .map_err(why)
    }

    /// The file to name in `SLURM_CONF`.
    pub fn configuration(&self) -> PathBuf {
        self.folder.path().join("slurm.conf")
    }

    /// Starts a daemon, which goes to the background by itself.
    fn daemon(&self, program: &str, arguments: &[&str]) -> Result<(), String> {
        let log = self.folder.path().join(format!("log/{program}.start"));
        let file = || {
            std::fs::File::options()
                .create(true)
                .append(true)
                .open(&log)
                .map_err(|error| error.to_string())
        };
        // Through `timeout`: a daemon that does not come up must not hang the tests.
        let status = Command::new("timeout")
            .args(["60", program])
            .args(arguments)
            .env("SLURM_CONF", self.configuration())
            .stdin(Stdio::null())
            .stdout(file()?)
            .stderr(file()?)
            .status()
            .map_err(|error| error.to_string())?;
        if status.success() {
            return Ok(());
        }
        let said = std::fs::read_to_string(&log).unwrap_or_default();
        Err(format!("`{program}` does not start ({status}): {}", said.trim()))
    }

    /// Answer of a client program; what it says when it fails.
    fn try_ask(&self, program: &str, arguments: &[&str]) -> Result<String, String> {
        let output = Command::new("timeout")
            .args(["120", program])
            .args(arguments)
            .env("SLURM_CONF", self.configuration())
            .stdin(Stdio::null())
            .output()
            .unwrap();
        let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).trim().to_owned();
        if output.status.success() {
            Ok(text(&output.stdout))
        } else {
            Err(format!("{}: {}", output.status, text(&output.stderr)))
        }
    }

    /// The same, again until it is answered: a busy controller answers late or not at all.
    pub fn ask(&self, program: &str, arguments: &[&str]) -> String {
        let mut answer = None;
        let mut said = String::new();
        wait_until(&format!("an answer of `{program}`"), || {
            match self.try_ask(program, arguments) {
                Ok(text) => answer = Some(text),
                // Told as it happens, so that a failure of the test shows what Slurm had to say.
                Err(why) if why != said => {
                    eprintln!("{program} {}: {why}", arguments.join(" "));
                    said = why;
                }
                Err(_) => {}
            }
            answer.is_some()
        });
        answer.unwrap_or_default()
    }

    /// Waits until none of these jobs waits or runs any more.
    pub fn wait_for(&self, ids: &[String]) {
        let list = ids.join(",");
        wait_until("Slurm jobs to end", || {
            // No answer is not the answer that nothing is left.
            self.try_ask("squeue", &["-h", "-r", "-o", "%i", "-j", &list])
                .is_ok_and(|left| left.is_empty())
        });
    }

    /// Kills the controller and both nodes' daemons as a power cut would, and starts them again with what they had saved.
    pub fn crash(&self) {
        let daemons: [(&str, &str, &[&str]); 3] = [
            ("slurmctld.pid", "slurmctld", &[]),
            ("slurmd.n1.pid", "slurmd", &["-N", "n1"]),
            ("slurmd.n2.pid", "slurmd", &["-N", "n2"]),
        ];
        for (file, program, arguments) in daemons {
            let id = std::fs::read_to_string(self.folder.path().join(file)).unwrap();
            let id = id.trim();
            assert!(
                Command::new("sh")
                    .args(["-c", &format!("kill -s KILL {id}")])
                    .status()
                    .unwrap()
                    .success()
            );
            wait_until(&format!("the end of `{program}`"), || !lives(id));
            self.daemon(program, arguments).unwrap();
        }
        wait_until("both nodes to come back", || {
            let states = self.try_ask("sinfo", &["-h", "-N", "-o", "%T"]).unwrap_or_default();
            let up = ["idle", "mixed", "allocated", "completing"];
            states.lines().count() == 2 && states.lines().all(|state| up.contains(&state))
        });
    }

    /// What `scontrol` says about an element of an array: one line of `Key=Value`.
    pub fn job(&self, id: &str) -> String {
        self.ask("scontrol", &["-o", "show", "job", id])
    }
}

impl Drop for Cluster {
    fn drop(&mut self) {
        for daemon in ["slurmd.n1.pid", "slurmd.n2.pid", "slurmctld.pid", "munge/pid"] {
            let Ok(id) = std::fs::read_to_string(self.folder.path().join(daemon)) else {
                continue;
            };
            let id = id.trim();
            let _ = Command::new("sh").args(["-c", &format!("kill -s TERM {id}")]).status();
            // The folder goes away with this value; the daemons write to it until they have ended.
            for _ in 0..100 {
                if !lives(id) {
                    break;
                }
                std::thread::sleep(Duration::from_millis(100));
            }
        }
    }
}

/// True while a process runs; one that ended and was not waited for does not.
pub fn lives(id: &str) -> bool {
    let stat = std::fs::read_to_string(Path::new("/proc").join(id).join("stat")).unwrap_or_default();
    stat.rsplit_once(") ").is_some_and(|(_, rest)| !rest.starts_with('Z'))
}

fn output(program: &str, arguments: &[&str]) -> Result<String, String> {
    let output = Command::new(program)
        .args(arguments)
        .output()
        .map_err(|error| format!("{program}: {error}"))?;
    Ok(String::from_utf8_lossy(&output.stdout).trim().to_owned())
}

fn command(program: &str, arguments: &[&str]) -> Result<(), String> {
    output(program, arguments).map(drop)
}

/// Three ports that nothing listens on.
fn free_ports() -> std::io::Result<[u16; 3]> {
    let sockets = [(); 3].map(|()| std::net::TcpListener::bind("127.0.0.1:0"));
    let mut ports = [0; 3];
    for (port, socket) in ports.iter_mut().zip(sockets) {
        *port = socket?.local_addr()?.port();
    }
    Ok(ports)
}
