"""Every parameter of a run: the options of all steps together, read from YAML and from `section.name=value`."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from polarmap.densify.options import DensifyOptions, PaperOptions, SurfaceOptions
from polarmap.errors import InputError
from polarmap.fusion.options import FusionOptions
from polarmap.io.formats.yaml_text import parse_yaml, read_yaml
from polarmap.odometry.options import OdometryOptions
from polarmap.options import Options
from polarmap.pipeline.options import KeyframeOptions
from polarmap.polarization.options import CueOptions
from polarmap.prior.options import PriorOptions
from polarmap.stereo.options import ConsistencyOptions, InlierOptions, PatchMatchOptions, StereoOptions

_RENAMED = {
    "consistency.max_cost": "consistency.min_score, which is 1 - max_cost",
    "inliers.max_cost_unseen": "inliers.min_score_unseen, which is 1 - max_cost_unseen",
}


class Config(Options):
    """All parameters, by step in the order of the pipeline."""

    odometry: OdometryOptions = OdometryOptions()
    keyframes: KeyframeOptions = KeyframeOptions()
    stereo: StereoOptions = StereoOptions()
    patchmatch: PatchMatchOptions = PatchMatchOptions()
    consistency: ConsistencyOptions = ConsistencyOptions()
    inliers: InlierOptions = InlierOptions()
    prior: PriorOptions = PriorOptions()
    cues: CueOptions = CueOptions()
    densify: DensifyOptions = DensifyOptions()
    surfaces: SurfaceOptions = SurfaceOptions()
    paper: PaperOptions = PaperOptions()
    fusion: FusionOptions = FusionOptions()

    @classmethod
    def from_mapping(cls, values: Any, source: str) -> Config:
        """From nested dictionaries, as YAML gives them; InputError names `source` and the bad parameter."""
        if values is None:
            values = {}
        if not isinstance(values, dict):
            raise InputError(f"{source}: must map sections to parameters, such as 'surfaces: {{cells: 4800}}'")
        sections: dict[str, Any] = {}
        for name, parameters in values.items():
            if name not in cls.model_fields:
                raise InputError(f"{source}: there is no section '{name}'; known are {', '.join(cls.model_fields)}")
            parameters = {} if parameters is None else parameters
            if not isinstance(parameters, dict):
                raise InputError(f"{source}: section '{name}' must map parameters to values")
            for parameter in parameters:
                _refuse_old_name(f"{name}.{parameter}", source)
            sections[name] = _section(cls.model_fields[name].annotation, parameters, f"{source}: {name}.")
        return cls(**sections)

    def with_settings(self, settings: Iterable[str]) -> Config:
        """A copy changed by settings of the form `section.name=value`, the value in YAML."""
        values = self.model_dump(mode="json")
        for setting in settings:
            path, equals, text = setting.partition("=")
            section, dot, name = path.strip().partition(".")
            if not (equals and dot and section and name):
                raise InputError(f"--set {setting}: must be section.name=value, such as surfaces.cells=4800")
            _refuse_old_name(path.strip(), f"--set {setting}")
            if name not in values.get(section, {}):
                raise InputError(f"--set {setting}: there is no parameter {path.strip()}; see 'polarmap config'")
            values[section][name] = parse_yaml(text, f"--set {setting}")
        return Config.from_mapping(values, "--set")

    def to_yaml(self) -> str:
        """As a file that `read_config` reads, with unit and meaning of each parameter as comments."""
        lines = []
        section = None
        for entry in self.parameters():
            if entry.section != section:
                section = entry.section
                lines.append(f"{section}:")
            value = yaml.safe_dump(entry.value, default_flow_style=True).removesuffix("...\n").strip()
            lines.append(f"  {entry.name}: {value}  # {entry.meaning}" + (f" [{entry.unit}]" if entry.unit else ""))
        return "\n".join(lines) + "\n"

    def parameters(self) -> Iterator[Parameter]:
        """Every parameter with its value, default, unit, meaning and source."""
        dumped = self.model_dump(mode="json")
        defaults = Config().model_dump(mode="json")
        for section in type(self).model_fields:
            for name, field in type(getattr(self, section)).model_fields.items():
                extra = field.json_schema_extra
                yield Parameter(
                    section, name, dumped[section][name], defaults[section][name], extra["unit"], field.description,
                    extra["source"],
                )  # fmt: skip


@dataclass(frozen=True)
class Parameter:
    """One parameter, for listings. source: the paper's section, empty where the paper has no such parameter."""

    section: str
    name: str
    value: Any
    default: Any
    unit: str
    meaning: str
    source: str


def read_config(path: Path) -> Config:
    """Config from a YAML file; what it leaves out keeps its default. Raises InputError naming file and problem."""
    return Config.from_mapping(read_yaml(path), str(path))


def _refuse_old_name(path: str, source: str) -> None:
    """InputError for a parameter of an earlier version, with its name today."""
    section, _, name = path.partition(".")
    today = _RENAMED.get(path)
    if section == "densify" and name in PaperOptions.model_fields:
        today = f"paper.{name}"
    if today is not None:
        raise InputError(f"{source}: {path} is now {today}")


def _section(options: type[Options], parameters: dict, prefix: str) -> Options:
    try:
        return options(**{str(name): value for name, value in parameters.items()})
    except InputError as error:
        raise InputError(f"{prefix}{error}") from None
