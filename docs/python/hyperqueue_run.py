"""Runs the lines of `rogs plan MANIFEST --emit jsonl --shards N` on HyperQueue: `python hyperqueue_run.py LINES [CPUS]`.

One job; a task a line, each waiting for the one before of its shard, so that shards run side by side and need not wait
for each other's stages. Needs `pip install hyperqueue`. The cluster is one worker on this machine; for others replace
`LocalCluster` by `hyperqueue.Client()`, which finds the server that `hq server start` started.
"""

import shlex
import sys

from hyperqueue import Job, LocalCluster
from hyperqueue.task.task import ResourceRequest


def job_of(lines, cpus):
    job, last = Job(), {}
    for words in map(shlex.split, lines):
        shard = words[words.index("--shard-index") + 1]
        before = [last[shard]] if shard in last else []
        last[shard] = job.program(words, deps=before, resources=ResourceRequest(cpus=cpus))
    return job


def main():
    with open(sys.argv[1], encoding="utf-8") as lines:
        job = job_of(lines, int(sys.argv[2]) if len(sys.argv) > 2 else 1)
    with LocalCluster() as cluster:
        cluster.start_worker()
        client = cluster.client()
        client.wait_for_jobs([client.submit(job)])


if __name__ == "__main__":
    main()
