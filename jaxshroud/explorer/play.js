// Move the frame on for as long as the button is pressed.
if (cb_obj.active) {
  cb_obj.label = "stop";
  const step = () => {
    if (!cb_obj.active) return;
    frame.setv({ value: frame.value >= frame.end ? 0 : frame.value + 1 }, { sync: false });
    setTimeout(step, interval);
  };
  step();
} else {
  cb_obj.label = "move";
}
