import sys
sys.path[:0]=['/tmp/w/data/tests','/tmp/w/data/tools','/tmp/w/data/tests/unit/datasets']
from pathlib import Path
from helpers.recording import datasets_synthetic
from surg_recording import datasets
from surg_recording.datasets import ExportOptions
root=Path('/tmp/w/oracle25')
folders=[datasets_synthetic.copy(root/'r1', root/f'c{i}', seed=100+i) for i in range(12)] if not (root/'c0').exists() else [root/f'c{i}' for i in range(12)]
r=datasets.load('lerobot_v21').write(folders, root/'set12', ExportOptions(executor='serial'))
print(r.ok, r.facts['splits'], r.warnings, r.errors, r.refused)
