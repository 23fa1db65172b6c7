-- Adds planned inputs to the commands of the autopilot while a switch of the transmitter is high (ArduPilot, Lua scripting).
-- The switch: RCx_OPTION = plan.switch (300 is Scripting1). Low ends the inputs at once; low, then high, begins them again.
-- The log message PLAN holds the time since the start [s] and the inputs [rad, or 1 of the throttle].

local plan = --[[PLAN]]

local EDGE = 1e-5 -- by which a sample may lie before a step [s]
local signals = {}

local function limited(value, low, high)
  return math.max(low, math.min(high, value))
end

function signals.Steps(s, t)
  local value = 0.0
  for k, edge in ipairs(s.edges) do
    value = value + (t - edge >= -EDGE and s.swings[k] or 0.0)
  end
  return value
end

function signals.Multisine(s, t)
  local value = 0.0
  for k, harmonic in ipairs(s.harmonics) do
    value = value + s.amplitudes[k] * math.sin(2.0 * math.pi * (harmonic * t / s.duration % 1.0) + s.phases[k])
  end
  return value
end

local function planned(axis, t)
  local value = 0.0
  for _, signal in ipairs(axis.signals) do
    local since = t - signal.start
    if since > -EDGE and since < signal.duration - EDGE then
      value = value + signals[signal.kind](signal, math.max(since, 0.0))
    end
  end
  return limited(value, -axis.amplitude, axis.amplitude)
end

local function pulse(servo, command) -- [us] of a command of -1, or of a range 0, to 1
  local stop = command > 0 and servo.high or servo.low
  return servo.middle + math.abs(command) * (stop - servo.middle)
end

for _, surface in ipairs(plan.surfaces) do
  surface.servos = {} -- all that have its function
  for channel = 0, 31 do
    local name = "SERVO" .. (channel + 1) .. "_"
    if param:get(name .. "FUNCTION") == surface.servo then
      local low, high = param:get(name .. "MIN"), param:get(name .. "MAX")
      if param:get(name .. "REVERSED") == 1 then
        low, high = high, low
      end
      local middle = surface.range and low or param:get(name .. "TRIM")
      table.insert(surface.servos, { channel = channel, low = low, middle = middle, high = high })
    end
  end
  if #surface.servos == 0 then
    gcs:send_text(2, "plan: no servo has the function " .. surface.servo .. " of the " .. surface.name)
    return
  end
end

local began, ready = nil, false

local function set(t)
  local values = {}
  for k, axis in ipairs(plan.axes) do
    values[k] = planned(axis, t)
  end
  for _, surface in ipairs(plan.surfaces) do
    local command = SRV_Channels:get_output_scaled(surface.servo) / surface.scale
    for k, part in ipairs(surface.parts) do
      command = command + part * values[k] / surface.full
    end
    command = limited(command, surface.range and 0.0 or -1.0, 1.0)
    for _, servo in ipairs(surface.servos) do
      local width = math.floor(pulse(servo, command) + 0.5)
      SRV_Channels:set_output_pwm_chan_timeout(servo.channel, width, 5 * plan.period) -- then the autopilot's own again
    end
  end
  logger:write("PLAN", plan.labels, plan.format, t, table.unpack(values))
end

local function update()
  local switch = rc:find_channel_for_option(plan.switch)
  local on = switch ~= nil and switch:get_aux_switch_pos() == 2 and arming:is_armed()
  if not on then
    if began then
      gcs:send_text(4, "plan: ended by the switch")
    end
    began, ready = nil, true
  elseif began == nil and ready then -- not at once if the switch was high when the script began
    began, ready = millis(), false
    gcs:send_text(6, "plan: begins")
  end
  if began then
    local t = 0.001 * (millis() - began):tofloat()
    if t <= plan.duration + 0.001 * plan.period then
      set(t)
    else
      began = nil
      gcs:send_text(6, "plan: complete")
    end
  end
  return update, plan.period
end

return update, plan.period
